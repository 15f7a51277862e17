//! The layers that make pixels of channels, and channels of pixels.

use super::blob::{Blob, Ratio};
use super::layer::Operation;
use super::param::Layer;
use super::parameters::Parameters;
use crate::error::UpsamplerError;

/// The largest factor of a shuffle.
pub const FACTOR: usize = 16;

/// PixelShuffle: larger images of fewer channels.
pub fn shuffle(
    layer: &Layer,
    (channels, ratio, reach): (usize, Ratio, f64),
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let factor = parameters.count(0, 1)?;
    // Mode 1 orders the channels in another way than PyTorch.
    parameters.must_be(1, "mode", 0)?;
    let whole = (1..=FACTOR).contains(&factor) && channels % (factor * factor) == 0;
    let larger = Ratio::new(factor, 1).and_then(|factor| ratio.times(factor));
    let (true, Some(ratio)) = (whole, larger) else {
        return Err(layer.wrong(format!("shuffles {channels} channels by {factor}")));
    };
    let channels = channels / (factor * factor);
    Ok((
        Operation::Shuffle(factor),
        Blob::Images {
            channels,
            ratio,
            reach,
        },
    ))
}

/// Reorg: smaller images of more channels.
pub fn unshuffle(
    layer: &Layer,
    (channels, ratio, reach): (usize, Ratio, f64),
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let factor = parameters.count(0, 1)?;
    parameters.must_be(1, "mode", 0)?;
    // Sides must be multiples of `factor`: the denominator joins the grain.
    let smaller = Ratio::new(1, factor).and_then(|factor| ratio.times(factor));
    let (true, Some(smaller)) = ((1..=FACTOR).contains(&factor), smaller) else {
        return Err(layer.wrong(format!("reorders by {factor}")));
    };
    let channels = channels * factor * factor;
    let reach = reach + factor as f64 / ratio.value();
    Ok((
        Operation::Unshuffle(factor),
        Blob::Images {
            channels,
            ratio: smaller,
            reach,
        },
    ))
}
