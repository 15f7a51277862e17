//! A frozen fully connected layer.

use compute::Array;
use compute::linear::{linear, linear_backward_input};

use crate::error::ModelError;
use crate::weights::Scope;

/// `y = x W^T + b`.
pub(crate) struct Linear {
    pub weight: Array,
    bias: Option<Array>,
}

impl Linear {
    pub fn read(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let bias = Some(scope.tensor("bias", &[outputs])?);
        Ok(Self { bias, ..Self::without_bias(scope, inputs, outputs)? })
    }

    pub fn without_bias(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        Ok(Self { weight: scope.tensor("weight", &[outputs, inputs])?, bias: None })
    }

    /// `x [.., inputs]` to `[.., outputs]`.
    pub fn forward(&self, x: &Array) -> Array {
        linear(x, &self.weight, self.bias.as_ref())
    }

    pub fn backward(&self, dy: &Array) -> Array {
        linear_backward_input(dy, &self.weight)
    }
}
