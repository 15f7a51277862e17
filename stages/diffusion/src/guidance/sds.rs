//! Score distillation sampling (DreamFusion, ICLR 2023): descend what the network takes for more
//! noise than there is.

use compute::Array;
use compute::elementwise::sub;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::invalid_option::{InvalidOption, positive};
use super::{Prediction, Rule, Timesteps};
use crate::schedule::{Schedule, scale};

/// Options of score distillation sampling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Sds {
    /// Step size of the residual's optimiser.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// Which timesteps it looks at.
    pub timesteps: Timesteps,
}

impl Default for Sds {
    fn default() -> Self {
        Self {
            rate: 0.02,
            timesteps: Timesteps::UNIFORM,
        }
    }
}

impl Rule for Sds {
    /// The direction (1 - alpha_bar) (eps_hat - eps).
    fn direction(&self, schedule: &Schedule, estimate: &Prediction) -> Array {
        // eps_hat - eps = (a / s) (z' - x0_hat): RSD's direction with another weight. So what makes
        // the two differ is mostly which timesteps they look at.
        let surplus = sub(
            &schedule.noise(estimate.noisy, estimate.velocity, estimate.t),
            estimate.noise,
        );
        // DreamFusion's weight w(t) is the noise's variance.
        scale(&surplus, estimate.t, |t| 1.0 - schedule.alpha_bar(t))
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn timesteps(&self) -> Timesteps {
        self.timesteps
    }

    fn check(&self) -> Result<(), InvalidOption> {
        positive("guidance.rate", self.rate)?;
        self.timesteps.check()
    }
}
