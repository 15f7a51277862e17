//! A frozen fully connected layer.

use compute::linear::{linear, linear_backward_input};
use compute::{Array, Device, Weight};

use crate::error::ModelError;
use crate::weights::Scope;

/// `y = x W^T + b`.
pub(crate) struct Linear {
    weight: Weight,
    bias: Option<Array>,
}

impl Linear {
    pub fn read(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let bias = Some(scope.tensor("bias", &[outputs])?);
        Ok(Self {
            bias,
            ..Self::without_bias(scope, inputs, outputs)?
        })
    }

    pub fn without_bias(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        Ok(Self {
            weight: scope.weight("weight", &[outputs, inputs])?,
            bias: None,
        })
    }

    /// How many numbers it gives.
    pub fn outputs(&self) -> usize {
        self.weight.shape()[0]
    }

    pub fn device(&self) -> &Device {
        self.weight.device()
    }

    /// `x [.., inputs]` to `[.., outputs]`.
    pub fn forward(&self, x: &Array) -> Array {
        linear(x, &self.weight, self.bias.as_ref())
    }

    pub fn backward(&self, dy: &Array) -> Array {
        linear_backward_input(dy, &self.weight)
    }
}
