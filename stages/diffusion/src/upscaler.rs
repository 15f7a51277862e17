//! A prior as the optimisation asks it: with two prompts, and the low-resolution image beside the
//! latent. Knows no rule.

use std::collections::BTreeMap;

use compute::elementwise::{scale, sub};
use compute::shape::{concat, slice};
use compute::{Array, Device, reduce};

use crate::guidance::Prompt;
use crate::lora::LoraNetwork;
use crate::optimize::{Denoiser, LoraParameters, Query};
use crate::prior::Prior;
use crate::schedule::Schedule;
use crate::unet::{Input, TextContext};

/// How many bytes of activations a LoRA step keeps beside the layers' inputs; the rest is computed
/// again.
const KEPT: usize = 1 << 30;

/// A latent upscaler and its two prompts, as its attentions see them.
pub struct Upscaler<'a> {
    prior: &'a Prior,
    positive: TextContext,
    negative: TextContext,
}

impl Prior {
    /// This prior as the optimisation asks it: guided from `negative_prompt` to `prompt`.
    pub fn denoiser(&self, prompt: &str, negative_prompt: &str) -> Upscaler<'_> {
        let [positive, negative] =
            [prompt, negative_prompt].map(|prompt| self.unet.text(&self.text(&[prompt])));
        Upscaler {
            prior: self,
            positive,
            negative,
        }
    }
}

impl Upscaler<'_> {
    fn text(&self, prompt: Prompt) -> &TextContext {
        match prompt {
            Prompt::Positive => &self.positive,
            Prompt::Negative => &self.negative,
        }
    }

    /// The loss of the one sample of `query`, and its gradient.
    fn sample_gradients(
        &self,
        query: &Query,
        camera: &Array,
        target: &Array,
        lora: &LoraNetwork,
    ) -> (f64, LoraParameters) {
        let schedule = &self.prior.schedule;
        let unet = &self.prior.unet;
        // The upscaler's classes are levels of noise of the low-resolution image.
        let labels = [query.noise_level];
        let sample = joined(query);
        let input = Input {
            lora: Some(lora),
            camera: Some(camera),
            ..asked(query, &sample, &labels)
        };
        // Always the positive prompt, as in ProlificDreamer: the LoRA learns without guidance.
        let (output, tape) = unet.forward_train(&input, &self.positive, KEPT);
        let error = sub(&schedule.velocity(&output, query.noisy, query.t), target);
        let gradient =
            // The derivative of the mean square by v is 2 error / n.
            schedule.velocity_backward(&scale(&error, 2.0 / error.len() as f32), query.t);
        let gradients = unet.backward(&input, &self.positive, tape, &gradient, false);
        (
            reduce::mean_square(&error).into(),
            gradients
                .adapters
                .into_iter()
                .chain(gradients.camera)
                .collect(),
        )
    }
}

impl Denoiser for Upscaler<'_> {
    fn device(&self) -> &Device {
        self.positive.states.device()
    }

    fn schedule(&self) -> &Schedule {
        &self.prior.schedule
    }

    fn low_schedule(&self) -> &Schedule {
        &self.prior.low_schedule
    }

    fn max_noise_level(&self) -> u32 {
        self.prior.max_noise_level
    }

    fn velocities(&self, query: &Query, prompts: &[Prompt]) -> Vec<Array> {
        let sample = joined(query);
        let labels = vec![query.noise_level; query.t.len()];
        let texts: Vec<&TextContext> = prompts.iter().map(|prompt| self.text(*prompt)).collect();
        let outputs = self
            .prior
            .unet
            .forward_each(&asked(query, &sample, &labels), &texts);
        outputs
            .iter()
            .map(|output| self.prior.schedule.velocity(output, query.noisy, query.t))
            .collect()
    }

    fn new_lora(&self, rank: u32, seed: u64) -> LoraParameters {
        // alpha = rank, so that the scale is 1, diffusers' default.
        let lora = self.prior.unet.new_lora(rank as usize, rank.into(), seed);
        lora.adapters.into_iter().chain(lora.camera).collect()
    }

    fn lora_velocity(&self, query: &Query, cameras: &Array, lora: &LoraParameters) -> Array {
        let sample = joined(query);
        let labels = vec![query.noise_level; query.t.len()];
        let lora = network(lora);
        let input = Input {
            lora: Some(&lora),
            camera: Some(cameras),
            ..asked(query, &sample, &labels)
        };
        let output = self.prior.unet.forward(&input, &self.positive);
        self.prior.schedule.velocity(&output, query.noisy, query.t)
    }

    /// One sample after the other, so that never more than one sample's activations are kept.
    fn lora_gradients(
        &self,
        query: &Query,
        cameras: &Array,
        target: &Array,
        lora: &LoraParameters,
    ) -> (f64, LoraParameters) {
        let lora = network(lora);
        // Means over samples add up to the mean over the batch, as all are of one size.
        let share = 1.0 / query.t.len() as f32;
        let mut loss = 0.0;
        let mut sum = LoraParameters::new();
        for i in 0..query.t.len() {
            let part = |x: &Array| slice(x, 0, i, 1);
            let noisy = part(query.noisy);
            let low = part(query.low);
            let sample = Query {
                noisy: &noisy,
                low: &low,
                t: &query.t[i..=i],
                noise_level: query.noise_level,
            };
            let (sample_loss, gradients) =
                self.sample_gradients(&sample, &part(cameras), &part(target), &lora);
            loss += sample_loss * f64::from(share);
            add_scaled(&mut sum, gradients, share);
        }
        (loss, sum)
    }
}

/// The network's sample: the noised latent and, beside it, the noised low-resolution image.
fn joined(query: &Query) -> Array {
    concat(&[query.noisy, query.low], 1)
}

/// What the frozen network is asked.
fn asked<'a>(query: &Query<'a>, sample: &'a Array, class_labels: &'a [u32]) -> Input<'a> {
    Input {
        sample,
        timesteps: query.t,
        class_labels,
        lora: None,
        camera: None,
    }
}

/// `sum + factor * terms`, name by name.
fn add_scaled(sum: &mut LoraParameters, terms: LoraParameters, factor: f32) {
    for (name, term) in terms {
        let scaled = scale(&term, factor);
        let total = sum
            .get(&name)
            .map(|sum| compute::elementwise::add(sum, &scaled));
        sum.insert(name, total.unwrap_or(scaled));
    }
}

/// The parameters as the network takes them; the adapters' product is not scaled.
fn network(parameters: &LoraParameters) -> LoraNetwork {
    let is_adapter = |name: &String| name.contains(".lora_");
    let (adapters, camera): (LoraParameters, LoraParameters) = parameters
        .iter()
        .map(|(name, values)| (name.clone(), values.clone()))
        .partition(|(name, _)| is_adapter(name));
    LoraNetwork {
        scale: 1.0,
        scales: BTreeMap::new(),
        adapters,
        camera,
    }
}
