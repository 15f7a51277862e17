//! Renoised score distillation (DiSR-NeRF, CVPR 2024): pull the latent towards the network's
//! estimate of it.

use compute::Array;
use compute::elementwise::sub;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::invalid_option::{InvalidOption, at_least_one, positive};
use super::{Prediction, Rule, Timesteps};
use crate::schedule::{Schedule, scale};

/// Options of renoised score distillation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Rsd {
    /// Step size of the residual's optimiser.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// Which timesteps it looks at.
    pub timesteps: Timesteps,
    /// How much a timestep counts.
    pub weight: Weighting,
}

/// How much a timestep counts: the omega of g = omega (z' - x0_hat).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub enum Weighting {
    /// All count the same.
    One,
    /// a_t' kappa(t, t') with t' = t - spacing: what squared distances between renoised latents
    /// give.
    Renoised {
        /// How many timesteps are between the two latents.
        #[schemars(range(min = 1))]
        spacing: u32,
    },
}

impl Default for Rsd {
    fn default() -> Self {
        Self {
            rate: 0.02,
            timesteps: Timesteps::ANNEALED,
            weight: Weighting::One,
        }
    }
}

impl Rule for Rsd {
    /// The direction omega (z' - x0_hat), where x0_hat is the guided estimate of the clean latent.
    fn direction(&self, schedule: &Schedule, estimate: &Prediction) -> Array {
        let to_clean = towards_clean(schedule, estimate);
        match self.weight {
            Weighting::One => to_clean,
            // The gradient of |z_t' - zhat_t'|^2 / 2 by z': a_t' since z_t' = a_t' z' + s_t' eps,
            // and kappa since the difference is kappa (z' - x0_hat). Under `L1` both weights are
            // the same: kappa is above 0.
            Weighting::Renoised { spacing } => scale(&to_clean, estimate.t, |t| {
                renoised(schedule, t, spacing).0 * kappa(schedule, t, spacing)
            }),
        }
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn timesteps(&self) -> Timesteps {
        self.timesteps
    }

    fn check(&self) -> Result<(), InvalidOption> {
        positive("guidance.rate", self.rate)?;
        self.timesteps.check()?;
        match self.weight {
            Weighting::One => Ok(()),
            Weighting::Renoised { spacing } => at_least_one("guidance.weight.spacing", spacing),
        }
    }
}

/// z' - x0_hat: descending it moves the latent to the network's estimate.
pub(super) fn towards_clean(schedule: &Schedule, estimate: &Prediction) -> Array {
    // x0_hat is held fixed: no gradient goes back through the network.
    sub(
        estimate.latent,
        &schedule.clean(estimate.noisy, estimate.velocity, estimate.t),
    )
}

/// kappa = a_t' - a_t s_t' / s_t, in z_t' - zhat_t' = kappa (z' - x0_hat): how far one
/// deterministic step of the sampler (DDIM) from t to t' = t - spacing moves along the estimate.
pub fn kappa(schedule: &Schedule, t: u32, spacing: u32) -> f64 {
    let (a, s) = renoised(schedule, t, spacing);
    // First-order DPM-Solver++ takes the same step.
    a - schedule.a(t) * s / schedule.s(t)
}

/// a and s at t' = t - spacing; below the first timestep there is no noise left.
fn renoised(schedule: &Schedule, t: u32, spacing: u32) -> (f64, f64) {
    t.checked_sub(spacing)
        .map_or((1.0, 0.0), |t| (schedule.a(t), schedule.s(t)))
}
