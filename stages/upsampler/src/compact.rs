//! SRVGGNetCompact, Real-ESRGAN's small network: 3x3 convolutions and PReLUs in a row at the
//! image's size, added to the image whose pixels are repeated.

use compute::Array;
use compute::activation::prelu;
use compute::elementwise::add;
use compute::shape::{pixel_shuffle, upsample_nearest};

use crate::convolution::Convolution;
use crate::error::UpsamplerError;
use crate::network::{Facts, Network};
use crate::tensors::Tensors;

/// A network of the family.
pub struct Compact {
    /// Convolutions, each with the slopes of the PReLU behind it.
    layers: Vec<(Convolution, Array)>,
    last: Convolution,
    scale: usize,
    width: usize,
}

impl Compact {
    /// Whether these tensors make one.
    pub fn is(tensors: &Tensors) -> bool {
        let axes = |name: &str| tensors.shape(name).map_or(0, <[usize]>::len);
        // A convolution, and behind it a PReLU with a number per channel.
        axes("body.0.weight") == 4 && axes("body.1.weight") == 1
    }

    /// The network of these tensors.
    pub fn read(tensors: &Tensors) -> Result<Self, UpsamplerError> {
        let [width, ..] = tensors.kernels("body.0.weight")?;
        // One convolution and one PReLU a layer: only PReLUs have odd numbers.
        let count = tensors.count(|i| format!("body.{}.weight", 2 * i + 1));
        let layer = |i: usize| {
            let inputs = if i == 0 { 3 } else { width };
            let convolution =
                Convolution::read(tensors, &format!("body.{}", 2 * i), inputs, width)?;
            Ok((
                convolution,
                tensors.array(&format!("body.{}.weight", 2 * i + 1), &[width])?,
            ))
        };
        let layers = (0..count)
            .map(layer)
            .collect::<Result<_, UpsamplerError>>()?;
        let last = format!("body.{}", 2 * count);
        let scale = tensors.scale(&format!("{last}.weight"))?;
        Ok(Self {
            layers,
            last: Convolution::read(tensors, &last, width, 3 * scale * scale)?,
            scale,
            width,
        })
    }
}

impl Network for Compact {
    fn forward(&self, x: &Array) -> Array {
        let deep = self.layers.iter().fold(x.clone(), |h, (layer, slopes)| {
            prelu(&layer.apply(&h), slopes)
        });
        add(
            // The network learns what nearest-neighbour enlargement lacks.
            &pixel_shuffle(&self.last.apply(&deep), self.scale),
            &upsample_nearest(x, self.scale),
        )
    }

    fn facts(&self) -> Facts {
        Facts {
            family: "SRVGGNetCompact",
            scale: self.scale,
            width: self.width,
            depth: format!("{} convolutions", self.layers.len() + 1),
            // Every 3x3 convolution sees one pixel further; the shuffle stays within a pixel.
            reach: self.layers.len() + 1,
            grain: 1,
            // Four bytes a number: a few feature maps at once, and a few of the result's size.
            bytes_per_pixel: 4 * (4 * self.width + 4 * 3 * self.scale * self.scale),
        }
    }
}
