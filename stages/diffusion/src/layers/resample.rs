//! Halving and doubling an image's size.

use compute::Array;
use compute::conv::Conv;
use compute::shape::{concat, crop, upsample_nearest, upsample_nearest_backward};

use super::Conv2d;
use super::conv::size;
use crate::error::ModelError;
use crate::weights::Scope;

/// A 3x3 convolution of stride 2.
pub(crate) struct Downsample(Conv2d);

impl Downsample {
    /// Padded on all sides, as in the UNet: n pixels become ceil(n/2).
    pub fn centred(scope: &Scope, channels: usize) -> Result<Self, ModelError> {
        Self::padded(scope, channels, [1; 4])
    }

    /// Padded at the bottom and right alone, as in the VAE: n pixels become floor(n/2).
    pub fn trailing(scope: &Scope, channels: usize) -> Result<Self, ModelError> {
        // Top, bottom, left, right.
        Self::padded(scope, channels, [0, 1, 0, 1])
    }

    fn padded(scope: &Scope, channels: usize, pad: [usize; 4]) -> Result<Self, ModelError> {
        Conv2d::with(
            &scope.at("conv"),
            channels,
            channels,
            3,
            Conv { stride: 2, pad },
        )
        .map(Self)
    }

    pub fn forward(&self, x: &Array) -> Array {
        self.0.forward(x)
    }

    /// `size` is the input's height and width.
    pub fn backward(&self, dy: &Array, size: [usize; 2]) -> Array {
        self.0.backward(dy, size)
    }
}

/// Every pixel doubled both ways, then a 3x3 convolution.
pub(crate) struct Upsample(Conv2d);

impl Upsample {
    pub fn read(scope: &Scope, channels: usize) -> Result<Self, ModelError> {
        Conv2d::read(&scope.at("conv"), channels, channels).map(Self)
    }

    /// `to` is the height and width wanted: twice the input's, or one less where halving had
    /// rounded up. There, nearest interpolation to that size is doubling without the last row or
    /// column.
    pub fn forward(&self, x: &Array, to: [usize; 2]) -> Array {
        // Cropped before the convolution, as in diffusers: its zeros must stand at the border that
        // stays.
        let doubled = upsample_nearest(x, 2);
        match size(&doubled) == to {
            true => self.0.forward(&doubled),
            false => self.0.forward(&crop(&doubled, 0, 0, to[0], to[1])),
        }
    }

    /// `from` is the input's height and width.
    pub fn backward(&self, dy: &Array, from: [usize; 2]) -> Array {
        let cropped = self.0.backward(dy, size(dy));
        // What was cropped had no influence, so its gradient is zero.
        let doubled = pad_end(&pad_end(&cropped, 2, 2 * from[0]), 3, 2 * from[1]);
        upsample_nearest_backward(&doubled, 2)
    }
}

/// Zeros after the end of `axis` up to the length `to`.
fn pad_end(x: &Array, axis: usize, to: usize) -> Array {
    let mut shape = x.shape().to_vec();
    if shape[axis] == to {
        return x.clone();
    }
    shape[axis] = to - shape[axis];
    concat(&[x, &x.device().zeros(&shape)], axis)
}
