//! Our own family, of which the embedded network is one: residual pairs of 3x3 convolutions at the
//! image's size, and what is missing from bicubic enlargement at four times it (as EDSR, Lim et al.
//! 2017, without its long way up).

use compute::Array;
use compute::conv::Finish;
use compute::elementwise::{offset, scale, scaled_sum};
use compute::resize::{Filter, resize};
use compute::shape::pixel_shuffle;

use crate::convolution::Convolution;
use crate::error::UpsamplerError;
use crate::network::{Facts, Network};
use crate::tensors::Tensors;

// These constants are part of the training (`models/training/network.py`): weights fit no others.
const SCALE: usize = 4;
/// Colours are taken relative to this grey, and spread to numbers of about 1.
const GREY: f32 = 0.45;
const SPREAD: f32 = 4.0;
/// The part of the last layer in the result.
const SHARE: f32 = 0.25;

/// A network of the family.
pub struct Residual {
    first: Convolution,
    pairs: Vec<[Convolution; 2]>,
    after: Convolution,
    last: Convolution,
    width: usize,
}

impl Residual {
    /// Whether these tensors make one.
    pub fn is(tensors: &Tensors) -> bool {
        [
            "first.weight",
            "a.0.weight",
            "b.0.weight",
            "after.weight",
            "last.weight",
        ]
        .iter()
        .all(|name| tensors.has(name))
    }

    /// The network of these tensors.
    pub fn read(tensors: &Tensors) -> Result<Self, UpsamplerError> {
        let [width, ..] = tensors.kernels("first.weight")?;
        let depth = tensors.count(|i| format!("a.{i}.weight"));
        let layer = |name: &str| Convolution::read(tensors, name, width, width);
        let pair = |i: usize| Ok([layer(&format!("a.{i}"))?, layer(&format!("b.{i}"))?]);
        Ok(Self {
            first: Convolution::read(tensors, "first", 3, width)?,
            pairs: (0..depth)
                .map(pair)
                .collect::<Result<_, UpsamplerError>>()?,
            after: layer("after")?,
            last: Convolution::read(tensors, "last", width, 3 * SCALE * SCALE)?,
            width,
        })
    }
}

impl Network for Residual {
    fn forward(&self, x: &Array) -> Array {
        let [height, width] = [SCALE * x.shape()[2], SCALE * x.shape()[3]];
        let first = self.first.apply(&scale(&offset(x, -GREY), SPREAD));
        let deep = self.pairs.iter().fold(first.clone(), |h, [a, b]| {
            // A slope of 0 is a ReLU.
            let inner = a.finished(&h, Finish::Leaky(0.0));
            b.finished(&inner, Finish::Add(&h))
        });
        let deep = self.after.finished(&deep, Finish::Add(&first));
        let detail = pixel_shuffle(&self.last.apply(&deep), SCALE);
        // The bicubic filter is the one that training added the network's result to.
        scaled_sum(&[
            (1.0, &resize(x, height, width, Filter::BicubicTorch, false)),
            (SHARE, &detail),
        ])
    }

    fn facts(&self) -> Facts {
        Facts {
            family: "Residual",
            scale: SCALE,
            width: self.width,
            depth: format!("{} pairs", self.pairs.len()),
            // Two a pair, and one each of `first`, `after` and `last`.
            reach: 3 + 2 * self.pairs.len(),
            grain: 1,
            bytes_per_pixel: 4 * (5 * self.width + 4 * 3 * SCALE * SCALE),
        }
    }
}
