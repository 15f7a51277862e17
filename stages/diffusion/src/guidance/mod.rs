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
mod rule;
mod sds;
mod timesteps;
mod vsd;

pub use invalid_option::InvalidOption;
pub(crate) use invalid_option::{at_least_one, at_most, decay, positive};
pub use loss::Loss;
pub use rsd::{Rsd, Weighting, kappa};
pub use rule::{LoraTraining, Rule};
pub use sds::Sds;
pub use timesteps::Timesteps;
pub use vsd::Vsd;

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
    Positive,
    /// What it should not be.
    Negative,
}

/// A noised batch and what the prior says of it; arrays `[N, C, h, w]` in scaled latent units.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<'a> {
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

/// Classifier-free guidance (Ho and Salimans 2022): negative + scale (positive - negative). At scale 1 the negative
/// prompt is not asked. `velocities` gives one for each prompt.
pub fn classifier_free(scale: f64, velocities: impl FnOnce(&[Prompt]) -> Vec<Array>) -> Array {
    // At scale 1 the negative velocity would be multiplied by 0; its pass through the network is
    // saved.
    let prompts: &[Prompt] = if scale == 1.0 {
        &[Prompt::Positive]
    } else {
        &[Prompt::Positive, Prompt::Negative]
    };
    match &velocities(prompts)[..] {
        [positive] => positive.clone(),
        [positive, negative] => {
            // Multiplied out, so that it is one pass over the arrays.
            scaled_sum(&[(scale as f32, positive), ((1.0 - scale) as f32, negative)])
        }
        other => unreachable!("{} velocities for {} prompts", other.len(), prompts.len()),
    }
}

impl Guidance {
    /// The rule behind the options: what all rules have in common.
    pub fn rule(&self) -> &dyn Rule {
        match self {
            Self::Rsd(rule) => rule,
            Self::Sds(rule) => rule,
            Self::Vsd(rule) => rule,
        }
    }
}
