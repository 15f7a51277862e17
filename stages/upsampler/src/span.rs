//! SPAN (Wan et al. 2024): blocks of three convolutions whose result, symmetric about zero, weighs
//! itself; no weights of attention.
//!
//! A convolution is trained as three in a row beside a fourth, which are one 3x3 convolution when
//! nothing is learned any more. The parts are what was trained: where a file holds them, the sum
//! that it may hold as well is computed anew.

use compute::Array;
use compute::activation::{sigmoid, silu};
use compute::elementwise::{add, add_channels, mul, offset, scale};
use compute::shape::{concat, pixel_shuffle};

use crate::convolution::Convolution;
use crate::error::UpsamplerError;
use crate::network::{Facts, Network};
use crate::tensors::Tensors;

/// Colours are taken relative to this mean of DIV2K's photos.
const MEAN: [f32; 3] = [0.4488, 0.4371, 0.4040];
/// The networks were trained on numbers from 0 to this.
const RANGE: f32 = 255.0;
const BLOCKS: usize = 6;

/// A network of the family.
pub struct Span {
    /// What is added to each colour, if the network was trained on normalised ones.
    shift: Option<Array>,
    first: Convolution,
    blocks: Vec<[Convolution; 3]>,
    after: Convolution,
    merge: Convolution,
    last: Convolution,
    scale: usize,
    width: usize,
}

impl Span {
    /// Whether these tensors make one.
    pub fn is(tensors: &Tensors) -> bool {
        let block = ["eval_conv.weight", "sk.weight"].map(|part| format!("block_1.c1_r.{part}"));
        tensors.has("conv_cat.weight") && block.iter().any(|name| tensors.has(name))
    }

    /// The network of these tensors.
    pub fn read(tensors: &Tensors) -> Result<Self, UpsamplerError> {
        let [width, ..] = tensors.kernels("conv_cat.weight")?;
        let scale = tensors.scale("upsampler.0.weight")?;
        let block = |i: usize| {
            let [a, b, c] = ["c1_r", "c2_r", "c3_r"].map(|name| format!("block_{i}.{name}"));
            Ok([
                collapsed(tensors, &a, width, width)?,
                collapsed(tensors, &b, width, width)?,
                collapsed(tensors, &c, width, width)?,
            ])
        };
        // The tensor's presence is the whole message; its value means nothing.
        let plain = tensors.has("no_norm");
        tensors.ignore("no_norm");
        Ok(Self {
            shift: (!plain).then(|| {
                tensors
                    .device()
                    .array(&[1, 3], MEAN.map(|mean| -mean).to_vec())
            }),
            first: collapsed(tensors, "conv_1", 3, width)?,
            blocks: (1..=BLOCKS)
                .map(block)
                .collect::<Result<_, UpsamplerError>>()?,
            after: collapsed(tensors, "conv_2", width, width)?,
            merge: Convolution::read_sized(tensors, "conv_cat", 4 * width, width, 1)?,
            last: Convolution::read(tensors, "upsampler.0", width, 3 * scale * scale)?,
            scale,
            width,
        })
    }

    /// The colours as the network was trained on them.
    fn normalised(&self, x: &Array) -> Array {
        let Some(shift) = &self.shift else {
            return x.clone();
        };
        let each = vec![shift; x.shape()[0]];
        scale(&add_channels(x, &concat(&each, 0)), RANGE)
    }
}

/// The convolution under the place `name`: the sum of its parts where there are such, else as it
/// stands there.
fn collapsed(
    tensors: &Tensors,
    name: &str,
    inputs: usize,
    outputs: usize,
) -> Result<Convolution, UpsamplerError> {
    // Training programs do not keep `eval_conv` up to date, so the parts come first.
    if !tensors.has(&format!("{name}.sk.weight")) {
        return Convolution::read(tensors, &format!("{name}.eval_conv"), inputs, outputs);
    }
    tensors.ignore(&format!("{name}.eval_conv.weight"));
    tensors.ignore(&format!("{name}.eval_conv.bias"));
    let [wide, ..] = tensors.kernels(&format!("{name}.conv.0.weight"))?;
    let [wider, ..] = tensors.kernels(&format!("{name}.conv.1.weight"))?;
    let part = |part: &str, shape: [usize; 4]| -> Result<_, UpsamplerError> {
        let weight = tensors
            .array(&format!("{name}.{part}.weight"), &shape)?
            .to_vec();
        Ok((
            weight,
            tensors
                .array(&format!("{name}.{part}.bias"), &shape[..1])?
                .to_vec(),
        ))
    };
    let (skip, skip_bias) = part("sk", [outputs, inputs, 1, 1])?;
    let (down, down_bias) = part("conv.2", [outputs, wider, 1, 1])?;
    let (middle, middle_bias) = part("conv.1", [wider, wide, 3, 3])?;
    let (up, up_bias) = part("conv.0", [wide, inputs, 1, 1])?;
    // The middle one behind the last: [outputs, wide, 9].
    // In f64: the sums have many terms, and the result is rounded once.
    let mut joined = vec![0.0; outputs * wide * 9];
    for (o, joined) in joined.chunks_mut(wide * 9).enumerate() {
        for (factor, row) in down[o * wider..][..wider]
            .iter()
            .zip(middle.chunks(wide * 9))
        {
            joined
                .iter_mut()
                .zip(row)
                .for_each(|(sum, x)| *sum += f64::from(*factor) * f64::from(*x));
        }
    }
    let mut weight = vec![0.0; outputs * inputs * 9];
    let mut bias = Vec::with_capacity(outputs);
    for o in 0..outputs {
        // The image is padded before the first of the three, so its bias is seen everywhere, beyond
        // the edge as well.
        let mut sum = f64::from(skip_bias[o]);
        sum += down[o * wider..][..wider]
            .iter()
            .zip(&middle_bias)
            .map(|(w, b)| f64::from(*w) * f64::from(*b))
            .sum::<f64>();
        sum += f64::from(down_bias[o]);
        for (a, taps) in joined[o * wide * 9..][..wide * 9].chunks(9).enumerate() {
            sum += taps.iter().sum::<f64>() * f64::from(up_bias[a]);
        }
        bias.push(sum as f32);
        for i in 0..inputs {
            for tap in 0..9 {
                // A 1x1 kernel is the middle tap of a 3x3 one.
                let mut sum = if tap == 4 {
                    f64::from(skip[o * inputs + i])
                } else {
                    0.0
                };
                sum += (0..wide)
                    .map(|a| joined[(o * wide + a) * 9 + tap] * f64::from(up[a * inputs + i]))
                    .sum::<f64>();
                weight[(o * inputs + i) * 9 + tap] = sum as f32;
            }
        }
    }
    let device = tensors.device();
    Ok(Convolution::new(
        device.array(&[outputs, inputs, 3, 3], weight),
        Some(device.array(&[outputs], bias)),
    ))
}

/// A block's result, and what its first convolution gives, activated.
fn block([a, b, c]: &[Convolution; 3], x: &Array) -> (Array, Array) {
    let first = silu(&a.apply(x));
    let third = c.apply(&silu(&b.apply(&first)));
    // Attention without weights: sigmoid minus 1/2 is odd, so both signs count alike.
    (mul(&add(&third, x), &offset(&sigmoid(&third), -0.5)), first)
}

impl Network for Span {
    fn forward(&self, x: &Array) -> Array {
        let first = self.first.apply(&self.normalised(x));
        let (early, _) = block(&self.blocks[0], &first);
        let (deep, late) = self.blocks[1..]
            .iter()
            .fold((early.clone(), None), |(h, _), layers| {
                let (h, first) = block(layers, &h);
                (h, Some(first))
            });
        let after = self.after.apply(&deep);
        // The order of the channels that `conv_cat` was trained on.
        let parts: Vec<&Array> = [&first, &after, &early].into_iter().chain(&late).collect();
        pixel_shuffle(
            &self.last.apply(&self.merge.apply(&concat(&parts, 1))),
            self.scale,
        )
    }

    fn facts(&self) -> Facts {
        Facts {
            family: "SPAN",
            scale: self.scale,
            width: self.width,
            depth: format!("{} blocks", self.blocks.len()),
            // Three a block, then `conv_1`, `conv_2`, `upsampler.0`; `conv_cat` is 1x1.
            reach: 3 * self.blocks.len() + 3,
            grain: 1,
            bytes_per_pixel: 4 * (9 * self.width + 2 * 3 * self.scale * self.scale),
        }
    }
}
