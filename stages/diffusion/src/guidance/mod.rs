//! The guidance rules: from what the networks say of a noised latent to the direction that the
//! latent descends.
//!
//! Everything here is a pure function of arrays. It knows no network, no view and no optimiser.

use compute::Array;
use compute::elementwise::scaled_sum;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod invalid_option;
mod loss;
mod rsd;
mod sds;
mod timesteps;
mod vsd;

pub use invalid_option::InvalidOption;
pub(crate) use invalid_option::{at_least_one, at_most, decay, positive};
pub use loss::Loss;
pub use rsd::{Rsd, Weight, kappa};
pub use sds::Sds;
pub use timesteps::Timesteps;
pub use vsd::Vsd;

use crate::schedule::Schedule;

/// The rule that residual latents follow, with its own options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Guidance {
    /// Renoised score distillation.
    Rsd(Rsd),
    /// Score distillation sampling.
    Sds(Sds),
    /// Variational score distillation.
    Vsd(Vsd),
}

/// Which of the two prompts a network is asked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// What the picture should be.
    Good,
    /// What it should not be.
    Bad,
}

/// A noised batch and what the prior says of it; arrays `[N, C, h, w]` in scaled latent units.
#[derive(Clone, Copy, Debug)]
pub struct Estimate<'a> {
    /// The current latent z' = z + h.
    pub latent: &'a Array,
    /// The noise eps that was added.
    pub noise: &'a Array,
    /// The noised latent z_t = a z' + s eps.
    pub noisy: &'a Array,
    /// The prior's velocity for it, guided between the prompts.
    pub velocity: &'a Array,
    /// The velocity of the prior with the LoRA, for variational score distillation. Where there is
    /// none, the LoRA takes no part.
    pub lora_velocity: Option<&'a Array>,
    /// One timestep for each of the N.
    pub t: &'a [u32],
}

/// Classifier-free guidance (Ho and Salimans 2022): bad + scale (good - bad). At scale 1 the bad
/// prompt is not asked. `velocities` gives one for each prompt.
pub fn classifier_free(scale: f64, velocities: impl FnOnce(&[Prompt]) -> Vec<Array>) -> Array {
    let prompts: &[Prompt] = if scale == 1.0 {
        &[Prompt::Good]
    } else {
        &[Prompt::Good, Prompt::Bad]
    };
    match &velocities(prompts)[..] {
        [good] => good.clone(),
        [good, bad] => scaled_sum(&[(scale as f32, good), ((1.0 - scale) as f32, bad)]),
        other => unreachable!("{} velocities for {} prompts", other.len(), prompts.len()),
    }
}

impl Guidance {
    /// The direction g that the latent descends.
    pub fn direction(&self, schedule: &Schedule, estimate: &Estimate) -> Array {
        match self {
            Self::Rsd(rule) => rule.direction(schedule, estimate),
            Self::Sds(rule) => rule.direction(schedule, estimate),
            Self::Vsd(rule) => rule.direction(schedule, estimate),
        }
    }

    /// Step size of the residual's optimiser.
    pub fn rate(&self) -> f64 {
        match self {
            Self::Rsd(rule) => rule.rate,
            Self::Sds(rule) => rule.rate,
            Self::Vsd(rule) => rule.rate,
        }
    }

    /// Which timesteps the rule looks at.
    pub fn timesteps(&self) -> Timesteps {
        match self {
            Self::Rsd(rule) => rule.timesteps,
            Self::Sds(rule) => rule.timesteps,
            Self::Vsd(rule) => rule.timesteps,
        }
    }

    /// Refuses numbers that make no sense.
    pub fn check(&self) -> Result<(), InvalidOption> {
        match self {
            Self::Rsd(rule) => rule.check(),
            Self::Sds(rule) => rule.check(),
            Self::Vsd(rule) => rule.check(),
        }
    }
}
