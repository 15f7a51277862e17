//! The optimisation, step by step. Knows the networks only as a [`Denoiser`].

use compute::elementwise::sub;
use compute::{Array, Rng, reduce};

use super::batch::{Batch, Batches};
use super::{
    Denoiser, GuidanceLog, LoraState, OptimizeError, Optimized, Options, Query, Residual, State,
    StepLog, ViewLatents, view,
};
use crate::guidance::{LoraTraining, Prediction, at_most, classifier_free};

/// The optimisation step by step, for callers that keep its state.
pub struct Optimization<'a> {
    prior: &'a dyn Denoiser,
    views: &'a [ViewLatents],
    options: &'a Options,
    batches: Batches,
    streams: Streams,
    state: State,
}

/// The random numbers of a step, by what they are for.
struct Streams {
    noise: Rng,
    timestep: Rng,
    lora_noise: Rng,
    lora_timestep: Rng,
    camera_drop: Rng,
}

impl<'a> Optimization<'a> {
    /// The optimisation before its first step: all residuals zero, and a LoRA that changes nothing.
    pub fn new(
        prior: &'a dyn Denoiser,
        views: &'a [ViewLatents],
        options: &'a Options,
        seed: u64,
    ) -> Result<Self, OptimizeError> {
        options.check()?;
        // With more noise than this the upscaler was not trained.
        at_most("noise_level", options.noise_level, prior.max_noise_level())?;
        let size = view::window_size(views, options.crop as usize)?;
        let residual = |view: &ViewLatents| {
            Residual::zero(
                [0, 1, 2].map(|i| view.latent.shape()[i]),
                &options.optimizer,
            )
        };
        let lora = options.guidance.rule().lora();
        let lora = lora.map(|lora| LoraState::new(prior.new_lora(lora.rank, seed)));
        Ok(Self {
            prior,
            views,
            options,
            batches: Batches::new(views.len(), options.batch as usize, size, seed),
            streams: Streams::new(seed),
            state: State {
                step: 0,
                residuals: views.iter().map(residual).collect(),
                lora,
            },
        })
    }

    /// This optimisation from where `state` left it. Fails if the state is of other views or
    /// options.
    pub fn resume(mut self, state: State) -> Result<Self, OptimizeError> {
        // Plain descent keeps no moments: their length tells the optimisers apart.
        let like = |a: &Residual, b: &Residual| a.shape == b.shape && a.mean.len() == b.mean.len();
        let same_views = self.state.residuals.len() == state.residuals.len()
            && self
                .state
                .residuals
                .iter()
                .zip(&state.residuals)
                .all(|(a, b)| like(a, b));
        if !same_views || self.state.lora.is_some() != state.lora.is_some() {
            return Err(OptimizeError::OtherState);
        }
        self.state = state;
        Ok(self)
    }

    /// All that lies between two steps.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Whether all steps are done.
    pub fn is_done(&self) -> bool {
        self.state.step >= u64::from(self.options.warm_up()) + u64::from(self.options.steps)
    }

    /// One step: guidance, unless the LoRA is still warming up, and then the LoRA, where it is its
    /// turn.
    pub fn step(&mut self) -> Result<StepLog, OptimizeError> {
        let step = self.state.step;
        let device = self.prior.device();
        let low = (self.prior.low_schedule(), self.options.noise_level);
        // Guidance and the LoRA share the batch, so that its images are noised once a step.
        let batch = self.batches.at(step, self.views, low, device);
        // During the warm-up the LoRA alone learns: until it has, the networks' difference is
        // guidance between prompts and nothing else, which drifts.
        let guided = step.checked_sub(self.options.warm_up().into());
        let guidance = guided
            .map(|guided| self.guide(&batch, guided))
            .transpose()?;
        let training = self.options.guidance.rule().lora();
        let lora_loss = training
            // In the warm-up the LoRA learns at every step, whatever `every` says.
            .filter(|lora| guided.is_none_or(|guided| guided % u64::from(lora.every) == 0))
            .and_then(|training| self.train_lora(&batch, &training));
        self.state.step += 1;
        Ok(StepLog {
            step,
            guidance,
            lora_loss,
        })
    }

    /// Moves the batch's residuals; `guided` counts guidance steps.
    fn guide(&mut self, batch: &Batch, guided: u64) -> Result<GuidanceLog, OptimizeError> {
        let step = self.state.step;
        let options = self.options;
        // z' = z + h, [N, C, h, w].
        let latent = batch.current(&self.state.residuals);
        let noise = self
            .streams
            .noise
            .normals(step, latent.shape(), self.prior.device());
        let t = self.timesteps(guided, batch.len());
        let direction = self.direction(batch, &latent, &noise, &t);
        // The loss counts masked pixels too; only the gradient is silenced there.
        let loss = options.loss.value(&direction);
        // Checked before the residuals move: what is kept in the checkpoint is then always a sound
        // state.
        if !loss.is_finite() {
            return Err(OptimizeError::Diverged { step });
        }
        self.descend(batch, &options.loss.gradient(&direction));
        Ok(GuidanceLog {
            timestep: t.iter().map(|&t| f64::from(t)).sum::<f64>() / t.len() as f64,
            loss,
            direction: rms(&direction),
            residual: rms(&sub(&batch.current(&self.state.residuals), &batch.latents)),
        })
    }

    fn timesteps(&self, guided: u64, views: usize) -> Vec<u32> {
        let timesteps = self.options.guidance.rule().timesteps();
        let len = self.prior.schedule().len();
        timesteps.at(
            guided,
            self.options.steps,
            views,
            len,
            &self.streams.timestep,
        )
    }

    /// The direction that the batch's latents descend.
    fn direction(&self, batch: &Batch, latent: &Array, noise: &Array, t: &[u32]) -> Array {
        let schedule = self.prior.schedule();
        let noisy = schedule.add_noise(latent, noise, t);
        let query = self.query(&noisy, batch, t);
        let velocity = classifier_free(self.options.guidance_scale, |prompts| {
            self.prior.velocities(&query, prompts)
        });
        let lora = self.state.lora.as_ref();
        // The LoRA's network sees the camera and no negative prompt: the difference of prompts
        // would be amplified noise in what is learnt from few pictures.
        let lora_velocity = lora.map(|lora| {
            self.prior
                .lora_velocity(&query, &batch.cameras, &lora.parameters)
        });
        let lora_velocity = lora_velocity.as_ref();
        let estimate = Prediction {
            latent,
            noise,
            noisy: &noisy,
            velocity: &velocity,
            lora_velocity,
            t,
        };
        self.options.guidance.rule().direction(schedule, &estimate)
    }

    fn query<'q>(&self, noisy: &'q Array, batch: &'q Batch, t: &'q [u32]) -> Query<'q> {
        Query {
            noisy,
            low: &batch.low,
            t,
            noise_level: self.options.noise_level,
        }
    }

    fn descend(&mut self, batch: &Batch, gradient: &Array) {
        // [N, C, h, w] on the host, where residuals and their moments lie.
        let mut gradient = gradient.to_vec();
        let len = gradient.len() / batch.len();
        for ((view, window), gradient) in batch.windows.iter().zip(gradient.chunks_mut(len)) {
            self.views[*view].silence(window, gradient);
        }
        let per_view = gradient.chunks(len);
        for ((view, window), gradient) in batch.windows.iter().zip(per_view) {
            let rate = self.options.guidance.rule().rate();
            let optimizer = &self.options.optimizer;
            self.state.residuals[*view].descend(window, gradient, rate, optimizer);
        }
    }

    /// One step of the LoRA towards the velocity of the current latents, at timesteps of the whole
    /// schedule.
    fn train_lora(&mut self, batch: &Batch, training: &LoraTraining) -> Option<f64> {
        let step = self.state.step;
        let schedule = self.prior.schedule();
        let lora = self.state.lora.as_mut()?;
        // After guidance has moved them: the LoRA learns what the latents look like now.
        let latent = batch.current(&self.state.residuals);
        // Timesteps of the whole schedule, whatever the guidance looks at: the annealing must not
        // find the LoRA untrained where it goes next.
        let t: Vec<u32> = (0..batch.len() as u64)
            .map(|i| self.streams.lora_timestep.below(step, i, schedule.len()))
            .collect();
        let noise = self
            .streams
            .lora_noise
            .normals(step, latent.shape(), self.prior.device());
        let noisy = schedule.add_noise(&latent, &noise, &t);
        let query = Query {
            noisy: &noisy,
            low: &batch.low,
            t: &t,
            noise_level: self.options.noise_level,
        };
        // Against v and not eps: the loss by eps is a^2 times that by v, and a^2 is 0.001 at t =
        // 980.
        let target = schedule.velocity_target(&latent, &noise, &t);
        // Without a camera now and then, the LoRA learns what all views share, too.
        let cameras = batch.cameras_kept(|i| {
            // Uniform numbers are below 1, so a share of 1 drops all cameras, and a share of 0
            // none.
            self.streams.camera_drop.uniform(step, i) >= training.camera_drop as f32
        });
        let (loss, gradients) =
            self.prior
                .lora_gradients(&query, &cameras, &target, &lora.parameters);
        lora.descend(&gradients, training.rate);
        Some(loss)
    }

    /// What it leaves behind, with the log of all steps.
    pub fn finish(self, log: Vec<StepLog>) -> Optimized {
        let array =
            |residual: Residual| self.prior.device().array(&residual.shape, residual.values);
        let residuals = self.state.residuals.into_iter().map(array).collect();
        Optimized {
            residuals,
            lora: self.state.lora.map(|lora| lora.parameters),
            log,
        }
    }
}

impl Streams {
    fn new(seed: u64) -> Self {
        let stream = |domain| Rng::new(seed, domain);
        Self {
            noise: stream("optimize/noise"),
            timestep: stream("optimize/timestep"),
            lora_noise: stream("optimize/lora_noise"),
            lora_timestep: stream("optimize/lora_timestep"),
            camera_drop: stream("optimize/camera_drop"),
        }
    }
}

fn rms(x: &Array) -> f64 {
    f64::from(reduce::mean_square(x)).sqrt()
}
