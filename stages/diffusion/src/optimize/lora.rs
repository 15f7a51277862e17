//! The LoRA in training: its parameters and their optimiser. Knows no network.

use std::collections::BTreeMap;

use compute::adam::{AdamState, update};
use compute::{elementwise, reduce};

use super::denoiser::LoraParameters;
use super::options::lora_adam;

/// A LoRA in training.
#[derive(Clone, Debug)]
pub struct LoraState {
    /// The tensors that are trained.
    pub parameters: LoraParameters,
    /// Adam's moments by the name of the parameter.
    pub moments: BTreeMap<String, AdamState>,
    /// Steps taken, those of the warm-up included. A step whose gradient overflowed does not count.
    pub steps: u64,
}

/// Gradients of a larger norm, over all parameters together, are scaled down to it.
// The same limit as in the paper's code.
const MAX_NORM: f64 = 1.0;

impl LoraState {
    /// Before the first step.
    pub fn new(parameters: LoraParameters) -> Self {
        let moments = parameters
            .iter()
            .map(|(name, values)| (name.clone(), AdamState::new(values)))
            .collect();
        Self {
            parameters,
            moments,
            steps: 0,
        }
    }

    /// One step of AdamW down the clipped gradients. Panics if there is none for some parameter.
    pub fn descend(&mut self, gradients: &LoraParameters, rate: f64) {
        let norm = norm(gradients);
        // Nothing is learnt from a gradient that overflowed, as the field's training has it: a
        // checkpoint would keep what it did.
        if !norm.is_finite() {
            return;
        }
        self.steps += 1;
        // One factor for all parameters keeps the gradient's direction.
        // A norm of 0 makes the factor infinite, and the minimum makes it 1 again.
        let clip = (MAX_NORM / norm).min(1.0) as f32;
        // Both maps have the same names, so that they are walked in step.
        for ((name, values), moments) in self.parameters.iter_mut().zip(self.moments.values_mut()) {
            let gradient = elementwise::scale(&gradients[name], clip);
            update(&lora_adam(rate), values, &gradient, moments, self.steps);
        }
    }
}

/// The Euclidean norm over all arrays together.
fn norm(arrays: &LoraParameters) -> f64 {
    let square = |array| f64::from(reduce::mean_square(array)) * array.len() as f64;
    arrays.values().map(square).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;

    #[test]
    fn a_gradient_that_overflowed_teaches_nothing() {
        let array = |value| Device::cpu().array(&[2], vec![1.0, value]);
        let named = |value| LoraParameters::from([("down".to_owned(), array(value))]);
        let mut state = LoraState::new(named(2.0));
        state.descend(&named(f32::NAN), 0.1);
        state.descend(&named(f32::INFINITY), 0.1);
        assert_eq!(state.parameters["down"].to_vec(), [1.0, 2.0]);
        assert_eq!(state.steps, 0);
        state.descend(&named(0.5), 0.1);
        assert!(state.parameters["down"].to_vec()[0] < 1.0);
        assert_eq!(state.steps, 1);
    }
}
