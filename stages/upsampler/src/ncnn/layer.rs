//! The layers that are computed, with their weights. Knows arrays, no files.

use compute::activation::{leaky_relu, prelu, sigmoid, silu};
use compute::conv::Finish;
use compute::elementwise::{add, add_channels, clamp, mul, offset, scale, scaled_sum, sub};
use compute::resize::{Filter, resize};
use compute::shape::{concat, pixel_shuffle, pixel_unshuffle, upsample_nearest};
use compute::{Array, Device};

use super::blob::Ratio;
use crate::convolution::Convolution;

/// A function of one number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Function {
    Same,
    Leaky(f32),
    Sigmoid,
    Swish,
    Clamp(f32, f32),
    Offset(f32),
    Scale(f32),
}

/// What a layer does with what it takes.
pub enum Operation {
    Convolution(Convolution, Function),
    Function(Function),
    Prelu(Array),
    Sum(Vec<f32>),
    Difference,
    Product,
    /// A number for each channel is added.
    Shift(Vec<f32>),
    Concat,
    Shuffle(usize),
    Unshuffle(usize),
    Nearest(usize),
    Resize(Filter, Ratio),
}

impl Function {
    pub fn apply(self, x: &Array) -> Array {
        match self {
            Self::Same => x.clone(),
            Self::Leaky(slope) => leaky_relu(x, slope),
            Self::Sigmoid => sigmoid(x),
            Self::Swish => silu(x),
            Self::Clamp(low, high) => clamp(x, low, high),
            Self::Offset(number) => offset(x, number),
            Self::Scale(factor) => scale(x, factor),
        }
    }
}

impl Operation {
    /// The layer's result. The builder has seen to it that the inputs fit.
    pub fn apply(&self, inputs: &[&Array]) -> Array {
        let x = inputs[0];
        let last = inputs[inputs.len() - 1];
        match self {
            // Applied before the numbers are stored, which saves a walk through memory.
            Self::Convolution(convolution, Function::Leaky(slope)) => {
                convolution.finished(x, Finish::Leaky(*slope))
            }
            Self::Convolution(convolution, function) => function.apply(&convolution.apply(x)),
            Self::Function(function) => function.apply(x),
            Self::Prelu(slopes) => prelu(x, slopes),
            Self::Sum(factors)
                // The common case, without multiplications.
                if factors.iter().all(|&factor| factor == 1.0) && inputs.len() == 2 =>
            {
                add(x, last)
            }
            Self::Sum(factors) => scaled_sum(
                &factors
                    .iter()
                    .copied()
                    .zip(inputs.iter().copied())
                    .collect::<Vec<_>>(),
            ),
            Self::Difference => sub(x, last),
            Self::Product => inputs[1..]
                .iter()
                .fold(x.clone(), |product, factor| mul(&product, factor)),
            Self::Shift(numbers) => {
                // `add_channels` wants a row of numbers for each image of the batch.
                add_channels(x, &for_each_image(x.device(), numbers, x.shape()[0]))
            }
            Self::Concat => concat(inputs, 1),
            Self::Shuffle(factor) => pixel_shuffle(x, *factor),
            Self::Unshuffle(factor) => pixel_unshuffle(x, *factor),
            Self::Nearest(factor) => upsample_nearest(x, *factor),
            Self::Resize(filter, ratio) => {
                let [height, width] =
                    [x.shape()[2], x.shape()[3]].map(|side| side * ratio.over / ratio.under);
                // Not antialiased: ncnn's Interp never is.
                resize(x, height, width, *filter, false)
            }
        }
    }
}

/// `[N, C]` of the same numbers.
fn for_each_image(device: &Device, numbers: &[f32], images: usize) -> Array {
    device.array(&[images, numbers.len()], numbers.repeat(images))
}
