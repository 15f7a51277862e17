//! `Optimize`: residual latents by score distillation (paper section 2.2, algorithm 1). Knows
//! nothing of images.

mod outputs;
mod view;

use artifacts_schema::{ImageSet, Latents, Log, Lora, Residuals};
use compute::Precision;
use diffusion::guidance::{Guidance, Loss, Timesteps};
use diffusion::optimize::{Optimization, OptimizeError, Optimizer, Options, StepLog};
use diffusion::{ModelSource, Prior};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::outputs::write;
use self::view::view;
use crate::checkpointer::Checkpointer;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::model::Model;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::prior;
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::size::{Foretold, Sizes, input};
use crate::stage::{Estimate, Extension, Stage};

/// The latents that are refined, and those that come out.
const LATENTS: Port<Latents> = Port::new("latents");
const LOW: Port<ImageSet> = Port::new("low");
const RESIDUALS: Port<Residuals> = Port::new("residuals");
const LOG: Port<Log> = Port::new("log");
const LORA: Port<Lora> = Port::new("lora");

/// Refines latents: one residual latent per view, guided by the prior.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Optimize {
    /// The latents, z.
    pub latents: Input,
    /// The low-resolution photos of the same views, on which the prior is conditioned.
    pub low: Input,
    /// The prior.
    pub model: ModelSource,
    /// How the prior's UNet multiplies.
    pub precision: Precision,
    /// The rule to follow, with its own options.
    pub guidance: Guidance,
    /// Guidance steps in all.
    #[schemars(range(min = 1))]
    pub steps: u32,
    /// Views in each step.
    #[schemars(range(min = 1))]
    pub batch: u32,
    /// How a residual descends its gradient.
    pub optimizer: Optimizer,
    /// How the direction becomes a gradient.
    pub loss: Loss,
    /// Scale of classifier-free guidance; at 1 the negative prompt is not asked.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub guidance_scale: f64,
    /// Height and width of the crops that a step looks at, in latent pixels.
    #[schemars(range(min = 1))]
    pub crop: u32,
    /// The timestep to which the low-resolution photo is noised.
    pub noise_level: u32,
    /// What the pictures should be.
    pub prompt: String,
    /// What they should not be.
    pub negative_prompt: String,
    /// In how many parts the views are refined, each a stage of its own with a LoRA of its own and
    /// its share of the steps. One part, in which all views share a LoRA, is the paper's method.
    #[schemars(range(min = 1))]
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

impl Default for Optimize {
    fn default() -> Self {
        let options = Options::default();
        Self {
            latents: Input::default(),
            low: Input::default(),
            model: ModelSource::default(),
            precision: Precision::default(),
            guidance: options.guidance,
            steps: options.steps,
            batch: options.batch,
            optimizer: options.optimizer,
            loss: options.loss,
            guidance_scale: options.guidance_scale,
            crop: options.crop,
            noise_level: options.noise_level,
            prompt: options.prompt,
            negative_prompt: options.negative_prompt,
            shards: 1,
            shard: 0,
        }
    }
}

impl Optimize {
    fn part(&self) -> Shard {
        Shard::new(self.shards, self.shard)
    }

    /// The library's options. Their fields stand in `Optimize` again, since serde's `flatten`
    /// cannot refuse unknown fields.
    fn options(&self) -> Options {
        Options {
            guidance: self.guidance,
            steps: self.steps,
            batch: self.batch,
            optimizer: self.optimizer,
            loss: self.loss,
            guidance_scale: self.guidance_scale,
            crop: self.crop,
            noise_level: self.noise_level,
            prompt: self.prompt.clone(),
            negative_prompt: self.negative_prompt.clone(),
        }
    }
}

impl Stage for Optimize {
    fn kind(&self) -> &'static str {
        "Optimize"
    }

    fn version(&self) -> u32 {
        4
    }

    fn check(&self) -> Result<(), StageError> {
        let wrong = self.options().check();
        wrong.map_err(|option| StageError::parameter(option.field, option.problem))?;
        shard::check(self.shards, self.shard)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![LATENTS.input(&self.latents), LOW.input(&self.low)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        let mut ports = vec![LATENTS.output(), RESIDUALS.output(), LOG.output()];
        // There is one LoRA for each part, and none that would stand for all of them.
        if self.guidance.rule().lora().is_some() && (self.shards == 1 || self.shard > 0) {
            ports.push(LORA.output());
        }
        ports
    }

    fn model(&self) -> Option<&dyn Model> {
        Some(&self.model)
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| {
            AnyStage::Optimize(Self {
                shard,
                ..self.clone()
            })
        })
    }

    fn extension(&self) -> Extension {
        match self.guidance.rule().timesteps() {
            Timesteps::Annealed { .. } => {
                Extension::Impossible("steps", "its timesteps fall over all steps")
            }
            Timesteps::Uniform { .. } => Extension::Possible("steps"),
        }
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        let latents = self.part().size(input(inputs, LATENTS.name));
        [LATENTS.name, RESIDUALS.name]
            .map(|name| (name, latents))
            .into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let inputs = &self.part().sizes(inputs);
        // The warm-up's steps take views as well.
        let images = f64::from(self.steps + self.options().warm_up()) * f64::from(self.batch);
        // All latents of the part and the photos beside them are on the device at once.
        // So are residuals, both moments of theirs, and a copy for a checkpoint.
        let latents = 2 * input(inputs, LATENTS.name).whole();
        let photos = 12 * input(inputs, LOW.name).pixels;
        let memory = latents + photos + prior::memory(&self.model);
        // Latents are read once, and written with the residuals beside them.
        let files = 3 * input(inputs, LATENTS.name).bytes;
        Estimate::of(input(inputs, LOW.name).held(), files as f64 / 1e8)
            .computing(memory, 0.1 * images)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let latents = io.latents(LATENTS)?;
        let low = io.images(LOW)?;
        let mut options = self.options();
        let all = latents.heads().views.len();
        // Before the model is loaded, so that a shard without views fails at once.
        let latents = self.part().latents(latents)?;
        // A part has fewer views, so it needs fewer steps to move each as often.
        options.steps = share(&options, all, latents.heads().views.len());
        let prior = Prior::load_in(&self.model, io.device, self.precision)?;
        let views: Vec<_> = latents
            .views()
            .map(|latent| view(&latent?, &low, io.device))
            .collect::<Result<_, StageError>>()?;
        let denoiser = prior.denoiser(&options.prompt, &options.negative_prompt);
        // A closure, since each checkpoint that is tried needs an optimisation of its own.
        let begin = || Optimization::new(&denoiser, &views, &options, io.seed).map_err(refused);
        let mut checkpointer =
            Checkpointer::new(io, u64::from(options.steps) + u64::from(options.warm_up()));
        let resumed = checkpointer.resume(|checkpoint| {
            let begun = begin().map_err(|error| error.to_string())?;
            let state = convert::optimization_state(checkpoint, begun.state(), io.device)?;
            let log: Vec<StepLog> =
                Vec::deserialize(&checkpoint.notes["log"]).map_err(|error| error.to_string())?;
            Ok((begun.resume(state).map_err(|error| error.to_string())?, log))
        })?;
        let (mut optimization, mut log) = match resumed {
            Some(resumed) => resumed,
            None => (begin()?, Vec::new()),
        };
        while !optimization.is_done() {
            let step = optimization.step().map_err(refused)?;
            // Before the state is kept, so that no checkpoint holds a LoRA that has diverged.
            check_finite(&step)?;
            log.push(step);
            let state = optimization.state();
            checkpointer.after(state.step, &figures(&step), || {
                convert::optimization_checkpoint(state, &log)
            })?;
        }
        // Kept only where a run of more steps can go on from it.
        if matches!(self.extension(), Extension::Possible(_)) {
            let state = optimization.state();
            checkpointer.keep(state.step, || convert::optimization_checkpoint(state, &log));
        }
        write(latents.heads(), &views, optimization.finish(log), io)
    }
}

/// The steps that move each of `part` views as often as those of the options move each of `all`
/// views.
fn share(options: &Options, all: usize, part: usize) -> u32 {
    // A batch never has more views than there are, so that a part's batches may be smaller.
    let batch = |views: usize| u64::from(options.batch).min(views as u64).max(1);
    let moves = u64::from(options.steps) * batch(all) * part as u64;
    // Rounded up: no view of a part moves less often than it would in the whole.
    moves.div_ceil(all.max(1) as u64 * batch(part)) as u32
}

/// A LoRA whose loss is not a number any more ends the stage, before its state is kept.
fn check_finite(log: &StepLog) -> Result<(), StageError> {
    if log.lora_loss.is_some_and(|loss| !loss.is_finite()) {
        return Err(StageError::Diverged {
            step: log.step + 1,
            rate: "guidance.lora_rate",
        });
    }
    Ok(())
}

fn refused(error: OptimizeError) -> StageError {
    match error {
        OptimizeError::Diverged { step } => StageError::Diverged {
            step: step + 1,
            rate: "guidance.rate",
        },
        other => StageError::Mismatch(other.to_string()),
    }
}

/// The figures of a step that progress shows.
fn figures(log: &StepLog) -> Vec<(&'static str, f64)> {
    let guidance = log
        .guidance
        .iter()
        .flat_map(|g| [("loss", g.loss), ("residual", g.residual)]);
    guidance
        .chain(log.lora_loss.map(|loss| ("lora", loss)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_moves_its_views_as_often_as_the_whole_would() {
        let options = |steps, batch| Options {
            steps,
            batch,
            ..Options::default()
        };
        assert_eq!(share(&options(60, 4), 21, 21), 60);
        assert_eq!(share(&options(60, 4), 21, 7), 20);
        assert_eq!(
            share(&options(60, 16), 21, 7),
            46,
            "60 * 16/21 moves of each view, all 7 at once"
        );
        assert_eq!(share(&options(60, 99), 21, 7), 60);
        assert_eq!(share(&options(1, 1), 21, 7), 1);
    }
}
