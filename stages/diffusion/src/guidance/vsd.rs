//! Variational score distillation (ProlificDreamer, NeurIPS 2023): descend the difference between
//! the prior's score and the score of what there is, which a LoRA of the same network learns along
//! the way.

use compute::Array;
use compute::elementwise::{scaled_sum, sub};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::invalid_option::{InvalidOption, at_least_one, not_negative, positive, share};
use super::{LoraTraining, Prediction, Rule, Timesteps, rsd};
use crate::schedule::{Schedule, scale};

/// Options of variational score distillation.
///
/// Unlike the other rules' directions, this one need not vanish where the latent is good: before
/// the LoRA has adapted it is the pure difference between prompts, afterwards the two networks'
/// disagreement. `warm_up`, `anchor` and a low `rate` keep it from drifting.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Vsd {
    /// Step size of the residual's optimiser.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// Which timesteps it looks at.
    pub timesteps: Timesteps,
    /// The LoRA learns on every such step: 1 for all of them, 3 for the paper's "spaced" training.
    #[schemars(range(min = 1))]
    pub lora_every: u32,
    /// Steps for the LoRA alone before the first guidance step.
    pub warm_up: u32,
    /// Step size of the LoRA's optimiser.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub lora_rate: f64,
    /// Rank of the LoRA.
    #[schemars(range(min = 1))]
    pub lora_rank: u32,
    /// How often the LoRA learns without its camera.
    #[schemars(range(min = 0, max = 1))]
    pub camera_drop: f64,
    /// Weight of renoised score distillation's z' - x0_hat in the direction; 0 for none.
    #[schemars(range(min = 0))]
    pub anchor: f64,
}

impl Default for Vsd {
    /// Measured with tiny-x4: at this anchor the rule stays within a tenth of a decibel of renoised
    /// score distillation, or above, for 1000 steps at this rate and for 2000 at twice the rate.
    /// With a weaker anchor the last timesteps of the annealing, where the rule weighs most, push
    /// the latents apart. The paper's LoRA rate of 1e-4 is for many more steps.
    fn default() -> Self {
        Self {
            rate: 0.005,
            timesteps: Timesteps::ANNEALED,
            lora_every: 1,
            warm_up: 50,
            lora_rate: 1e-3,
            // As diffusers' adapters of attention.
            lora_rank: 4,
            // As ProlificDreamer and threestudio.
            camera_drop: 0.1,
            anchor: 0.5,
        }
    }
}

impl Rule for Vsd {
    /// The direction (1 - alpha_bar) (eps_prior - eps_lora) = (1 - alpha_bar) a (v_prior - v_lora),
    /// plus the anchor.
    fn direction(&self, schedule: &Schedule, estimate: &Prediction) -> Array {
        let disagreement = sub(
            estimate.velocity,
            // Without a LoRA the two agree, and nothing but the anchor is left.
            estimate.lora_velocity.unwrap_or(estimate.velocity),
        );
        let direction = scale(&disagreement, estimate.t, |t| {
            // From eps = a v + s z_t: both networks see the same z_t, so s z_t cancels and a is
            // left.
            (1.0 - schedule.alpha_bar(t)) * schedule.a(t)
        });
        if self.anchor == 0.0 {
            return direction;
        }
        // The disagreement need not vanish where the latent is good. The anchor does, and so stops
        // what would drift.
        scaled_sum(&[
            (1.0, &direction),
            (self.anchor as f32, &rsd::towards_clean(schedule, estimate)),
        ])
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn timesteps(&self) -> Timesteps {
        self.timesteps
    }

    fn lora(&self) -> Option<LoraTraining> {
        Some(LoraTraining {
            every: self.lora_every,
            warm_up: self.warm_up,
            rate: self.lora_rate,
            rank: self.lora_rank,
            camera_drop: self.camera_drop,
        })
    }

    fn check(&self) -> Result<(), InvalidOption> {
        positive("guidance.rate", self.rate)?;
        self.timesteps.check()?;
        at_least_one("guidance.lora_every", self.lora_every)?;
        positive("guidance.lora_rate", self.lora_rate)?;
        at_least_one("guidance.lora_rank", self.lora_rank)?;
        share("guidance.camera_drop", self.camera_drop)?;
        not_negative("guidance.anchor", self.anchor)
    }
}
