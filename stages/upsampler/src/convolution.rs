//! A convolution with bias that keeps the image's size: what all of these networks are made of.

use compute::conv::{Conv, Finish, conv2d_finished};
use compute::{Array, Weight};

use crate::error::UpsamplerError;
use crate::tensors::Tensors;

/// A convolution of stride 1 whose padding makes up for its kernel.
pub struct Convolution {
    /// Networks run tile after tile, so what is made of a weight is kept.
    weight: Weight,
    bias: Option<Array>,
    pad: [usize; 4],
}

impl Convolution {
    /// The convolution with `weight [O, C, kh, kw]`, whose kernel has odd sides, and `bias [O]`.
    pub fn new(weight: Array, bias: Option<Array>) -> Self {
        let [height, width] = [weight.shape()[2] / 2, weight.shape()[3] / 2];
        Self {
            // Winograd transforms take four times the weight's memory, and are used by every tile.
            weight: Weight::from(weight).keeping_transforms(),
            bias,
            // Zeros around the image, with which all of these networks were trained.
            pad: [height, height, width, width],
        }
    }

    /// The 3x3 convolution under the place `name`, from `inputs` channels to `outputs`.
    pub fn read(
        tensors: &Tensors,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self, UpsamplerError> {
        Self::read_sized(tensors, name, inputs, outputs, 3)
    }

    /// The convolution under the place `name` with a kernel of `side` by `side`.
    pub fn read_sized(
        tensors: &Tensors,
        name: &str,
        inputs: usize,
        outputs: usize,
        side: usize,
    ) -> Result<Self, UpsamplerError> {
        let weight = tensors.array(&format!("{name}.weight"), &[outputs, inputs, side, side])?;
        Ok(Self::new(
            weight,
            Some(tensors.array(&format!("{name}.bias"), &[outputs])?),
        ))
    }

    /// `x [N, C, H, W]` convolved: `[N, O, H, W]`.
    pub fn apply(&self, x: &Array) -> Array {
        self.finished(x, Finish::None)
    }

    /// `x` convolved and finished before it is stored; what is added is `[N, O, H, W]`.
    pub fn finished(&self, x: &Array, finish: Finish<&Array>) -> Array {
        let conv = Conv {
            stride: 1,
            pad: self.pad,
        };
        conv2d_finished(x, &self.weight, self.bias.as_ref(), conv, finish)
    }
}
