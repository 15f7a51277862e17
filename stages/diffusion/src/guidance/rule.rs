//! What a guidance rule is. Knows no rule.

use compute::Array;

use super::{InvalidOption, Prediction, Timesteps};
use crate::schedule::Schedule;

/// A guidance rule: how a latent follows what the networks say of it.
///
/// A new rule is a file beside this one with an `impl Rule`, and a variant of [`super::Guidance`].
pub trait Rule {
    /// The direction g that the latent descends, of the latent's shape `[N, C, h, w]`.
    fn direction(&self, schedule: &Schedule, estimate: &Prediction) -> Array;

    /// Step size of the residual's optimiser.
    fn rate(&self) -> f64;

    /// Which timesteps the rule looks at.
    fn timesteps(&self) -> Timesteps;

    /// How a LoRA learns what the latents look like; `None` for a rule that needs none.
    fn lora(&self) -> Option<LoraTraining> {
        None
    }

    /// Refuses numbers that make no sense.
    fn check(&self) -> Result<(), InvalidOption>;
}

/// How the LoRA of a rule learns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoraTraining {
    /// It learns on every such step.
    pub every: u32,
    /// Steps for the LoRA alone before the first guidance step.
    pub warm_up: u32,
    /// Step size of its optimiser.
    pub rate: f64,
    /// Its rank, r in alpha / r.
    pub rank: u32,
    /// How often it learns without its camera.
    pub camera_drop: f64,
}
