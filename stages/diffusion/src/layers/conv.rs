//! A frozen convolution.

use compute::conv::{Conv, conv2d, conv2d_backward_input};
use compute::{Array, Weight};

use crate::error::ModelError;
use crate::weights::Scope;

/// A convolution with bias over `[N, C, H, W]`.
pub(crate) struct Conv2d {
    weight: Weight,
    bias: Array,
    conv: Conv,
}

impl Conv2d {
    /// 3x3 over an image padded by one pixel of zeros.
    pub fn read(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        Self::with(scope, inputs, outputs, 3, Conv::padded(1))
    }

    /// 1x1 without padding: a linear layer over channels.
    pub fn pointwise(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        Self::with(scope, inputs, outputs, 1, Conv::default())
    }

    pub fn with(
        scope: &Scope,
        inputs: usize,
        outputs: usize,
        kernel: usize,
        conv: Conv,
    ) -> Result<Self, ModelError> {
        let weight = scope.weight("weight", &[outputs, inputs, kernel, kernel])?;
        Ok(Self {
            weight,
            bias: scope.tensor("bias", &[outputs])?,
            conv,
        })
    }

    pub fn forward(&self, x: &Array) -> Array {
        conv2d(x, &self.weight, Some(&self.bias), self.conv)
    }

    /// `size` is the input's height and width.
    pub fn backward(&self, dy: &Array, size: [usize; 2]) -> Array {
        conv2d_backward_input(dy, &self.weight, self.conv, size)
    }
}

/// Height and width of `[N, C, H, W]`.
pub(crate) fn size(x: &Array) -> [usize; 2] {
    [x.shape()[2], x.shape()[3]]
}
