//! RRDBNet (Wang et al. 2018), the network of ESRGAN and Real-ESRGAN: residual blocks within
//! residual blocks of densely connected convolutions, then twice the size, once or more.
//!
//! Real-ESRGAN's for x2 and x1 are the one for x4 behind a pixel unshuffle. ESRGAN's older files
//! name tensors by place; [`rename`] gives the names that are used here.

use compute::Array;
use compute::conv::Finish;
use compute::elementwise::scaled_sum;
use compute::shape::{concat, pixel_unshuffle, upsample_nearest};

use crate::convolution::Convolution;
use crate::error::UpsamplerError;
use crate::network::{Facts, Network};
use crate::tensors::Tensors;

const SLOPE: f32 = 0.2;
/// The part of a block's result that is added to what it was given.
const SHARE: f32 = 0.2;
/// More doublings than any network has.
const DOUBLINGS: usize = 4;

/// Five convolutions, each of which sees what all before it gave.
struct Dense([Convolution; 5]);

/// A network of the family.
pub struct Rrdb {
    first: Convolution,
    blocks: Vec<[Dense; 3]>,
    after: Convolution,
    /// Each behind a doubling of the size.
    ups: Vec<Convolution>,
    high: Convolution,
    last: Convolution,
    unshuffle: usize,
    width: usize,
    growth: usize,
}

/// The names that are used here for those of older files; others stay as they are.
pub fn rename(tensors: &mut Tensors) -> Result<(), UpsamplerError> {
    if tensors.has("RRDB_trunk.0.RDB1.conv1.weight") {
        return tensors.rename(|name| {
            let name = name
                .replace("RRDB_trunk.", "body.")
                .replace("trunk_conv.", "conv_body.")
                .replace(".RDB", ".rdb");
            name.replace("upconv", "conv_up")
                .replace("HRconv.", "conv_hr.")
        });
    }
    if !tensors.has("model.1.sub.0.RDB1.conv1.0.weight") {
        return Ok(());
    }
    let blocks = tensors.count(|i| format!("model.1.sub.{i}.RDB1.conv1.0.weight"));
    // Behind the blocks: a doubling and its convolution, with an activation, take three places;
    // then come two more convolutions with one between them.
    // The last convolution's place tells how many doublings there are: three places each.
    let ups = (0..=DOUBLINGS)
        .find(|ups| tensors.has(&format!("model.{}.weight", 3 * ups + 4)))
        .unwrap_or_default();
    let mut places = vec![("model.0".to_owned(), "conv_first".to_owned())];
    places.push((format!("model.1.sub.{blocks}"), "conv_body".to_owned()));
    places.extend((1..=ups).map(|i| (format!("model.{}", 3 * i), format!("conv_up{i}"))));
    places.push((format!("model.{}", 3 * ups + 2), "conv_hr".to_owned()));
    places.push((format!("model.{}", 3 * ups + 4), "conv_last".to_owned()));
    tensors.rename(|name| {
        let place = name.rsplit_once('.').and_then(|(place, rest)| {
            Some(format!(
                "{}.{rest}",
                places.iter().find(|(old, _)| old == place)?.1
            ))
        });
        let dense = || {
            let (block, rest) = name.strip_prefix("model.1.sub.")?.split_once(".RDB")?;
            let (layer, rest) = rest.split_once(".conv")?;
            let (number, rest) = rest.split_once(".0.")?;
            Some(format!("body.{block}.rdb{layer}.conv{number}.{rest}"))
        };
        place.or_else(dense).unwrap_or_else(|| name.to_owned())
    })
}

impl Dense {
    fn read(
        tensors: &Tensors,
        name: &str,
        width: usize,
        growth: usize,
    ) -> Result<Self, UpsamplerError> {
        let layer = |i: usize, outputs| {
            Convolution::read(
                tensors,
                &format!("{name}.conv{i}"),
                width + (i - 1) * growth,
                outputs,
            )
        };
        Ok(Self([
            layer(1, growth)?,
            layer(2, growth)?,
            layer(3, growth)?,
            layer(4, growth)?,
            layer(5, width)?,
        ]))
    }

    fn apply(&self, x: &Array) -> Array {
        // Channels after i layers: width + i growth, the newest last.
        let [grow @ .., last] = &self.0;
        let seen = grow.iter().fold(x.clone(), |seen, layer| {
            let new = layer.finished(&seen, Finish::Leaky(SLOPE));
            concat(&[&seen, &new], 1)
        });
        scaled_sum(&[(SHARE, &last.apply(&seen)), (1.0, x)])
    }
}

impl Rrdb {
    /// Whether these tensors make one.
    pub fn is(tensors: &Tensors) -> bool {
        tensors.has("conv_first.weight") && tensors.has("body.0.rdb1.conv1.weight")
    }

    /// The network of these tensors.
    pub fn read(tensors: &Tensors) -> Result<Self, UpsamplerError> {
        let [width, inputs, ..] = tensors.kernels("conv_first.weight")?;
        let [growth, ..] = tensors.kernels("body.0.rdb1.conv1.weight")?;
        // 3 s^2 channels are an image behind an unshuffle by s.
        let unshuffle = match inputs {
            3 => 1,
            12 => 2,
            48 => 4,
            _ => {
                return Err(tensors.wrong(
                    "conv_first.weight",
                    format!("takes {inputs} channels; known are 3, 12 and 48"),
                ));
            }
        };
        let count = tensors.count(|i| format!("body.{i}.rdb1.conv1.weight"));
        let dense =
            |i: usize, j: usize| Dense::read(tensors, &format!("body.{i}.rdb{j}"), width, growth);
        let block = |i: usize| Ok([dense(i, 1)?, dense(i, 2)?, dense(i, 3)?]);
        let ups = tensors.count(|i| format!("conv_up{}.weight", i + 1));
        // `ups` is a foreign file's count: bounded before it shifts, and the scale must be whole.
        if 1 << ups.min(DOUBLINGS) < unshuffle || ups > DOUBLINGS {
            let problem = format!(
                "is unshuffled by {unshuffle} and doubled {ups} times, which is no enlargement"
            );
            return Err(tensors.wrong("conv_first.weight", problem));
        }
        let layer = |name: &str| Convolution::read(tensors, name, width, width);
        Ok(Self {
            first: Convolution::read(tensors, "conv_first", inputs, width)?,
            blocks: (0..count)
                .map(block)
                .collect::<Result<_, UpsamplerError>>()?,
            after: layer("conv_body")?,
            ups: (1..=ups)
                .map(|i| layer(&format!("conv_up{i}")))
                .collect::<Result<_, _>>()?,
            high: layer("conv_hr")?,
            last: Convolution::read(tensors, "conv_last", width, 3)?,
            unshuffle,
            width,
            growth,
        })
    }
}

impl Network for Rrdb {
    fn forward(&self, x: &Array) -> Array {
        let x = if self.unshuffle == 1 {
            x.clone()
        } else {
            pixel_unshuffle(x, self.unshuffle)
        };
        let first = self.first.apply(&x);
        let deep = self.blocks.iter().fold(first.clone(), |x, block| {
            let y = block.iter().fold(x.clone(), |x, dense| dense.apply(&x));
            scaled_sum(&[(SHARE, &y), (1.0, &x)])
        });
        let start = self.after.finished(&deep, Finish::Add(&first));
        let high = self.ups.iter().fold(start, |h, up| {
            up.finished(&upsample_nearest(&h, 2), Finish::Leaky(SLOPE))
        });
        let high = self.high.finished(&high, Finish::Leaky(SLOPE));
        self.last.apply(&high)
    }

    fn facts(&self) -> Facts {
        let doubled = 1 << self.ups.len();
        // Seen from the small image, each doubling halves what a convolution behind it adds;
        // rounded up.
        // Fifteen convolutions a block, each a pixel further.
        let low = 2 + 15 * self.blocks.len() + 3;
        Facts {
            family: "RRDBNet",
            scale: doubled / self.unshuffle,
            width: self.width,
            depth: format!("{} blocks", self.blocks.len()),
            reach: low * self.unshuffle,
            grain: self.unshuffle,
            bytes_per_pixel: 4
                * (3 * self.width * doubled * doubled + 4 * (self.width + 4 * self.growth))
                / (self.unshuffle * self.unshuffle),
        }
    }
}
