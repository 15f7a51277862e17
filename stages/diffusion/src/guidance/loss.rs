//! From a direction to a loss and its gradient. Knows no rule and no optimiser.

use compute::{Array, elementwise, reduce};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The distance between a latent z' and its target z' - g, where the target is held fixed.
///
/// The gradient is not divided by the number of views in a step: each view has a residual of its
/// own, so a rate means the same for any batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Loss {
    /// Half the squared distance; its gradient is g (DreamFusion, ProlificDreamer, threestudio).
    #[default]
    L2,
    /// The absolute distance; its gradient is the sign of g, so that the rules' weights no longer
    /// count (DiSR-NeRF and the paper's code, up to a constant).
    L1,
}

impl Loss {
    /// The loss, as a mean over all elements.
    pub fn value(self, direction: &Array) -> f64 {
        match self {
            Self::L2 => 0.5 * f64::from(reduce::mean_square(direction)),
            // The mean of |g| as g sign(g).
            Self::L1 => f64::from(reduce::mean(&elementwise::mul(
                direction,
                &elementwise::sign(direction),
            ))),
        }
    }

    /// The gradient by the latent, element by element.
    pub fn gradient(self, direction: &Array) -> Array {
        match self {
            Self::L2 => direction.clone(),
            Self::L1 => elementwise::sign(direction),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;

    #[test]
    fn l2_keeps_the_direction_and_l1_its_sign() {
        let direction = Device::cpu().array(&[4], vec![0.5, -2.0, 0.0, 1.5]);
        assert_eq!(
            Loss::L2.gradient(&direction).to_vec(),
            [0.5, -2.0, 0.0, 1.5]
        );
        assert_eq!(
            Loss::L1.gradient(&direction).to_vec(),
            [1.0, -1.0, 0.0, 1.0]
        );
        assert_eq!(
            (Loss::L2.value(&direction), Loss::L1.value(&direction)),
            (0.8125, 1.0)
        );
    }
}
