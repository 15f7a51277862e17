//! The kinds of layers that have much to check, each with its parameters and weights, and what is
//! known of its result.

use compute::resize::Filter;

use super::blob::{Blob, Ratio};
use super::layer::{Function, Operation};
use super::param::Layer;
use super::parameters::Parameters;
use super::weights::Weights;
use crate::convolution::Convolution;
use crate::error::UpsamplerError;

/// The error about a layer of a kind that is not known here, or that is not for what it takes.
pub fn unknown(layer: &Layer) -> UpsamplerError {
    layer.wrong(format!(
        "with {} inputs is of a kind that is not known here",
        layer.inputs.len()
    ))
}

/// The facts of all inputs, which are images of one size.
pub fn all_images(
    layer: &Layer,
    blobs: &[&Blob],
) -> Result<Vec<(usize, Ratio, f64)>, UpsamplerError> {
    let facts = |blob: &&Blob| match blob {
        Blob::Images {
            channels,
            ratio,
            reach,
        } => Ok((*channels, *ratio, *reach)),
        Blob::Constant(_) => Err(layer.wrong("takes a constant where it should take images")),
    };
    let images = blobs.iter().map(facts).collect::<Result<Vec<_>, _>>()?;
    let [(_, ratio, _), ..] = &images[..] else {
        return Err(layer.wrong("takes nothing"));
    };
    // In ncnn some of these are broadcast, which none of the known networks needs.
    if images.iter().any(|(_, other, _)| other != ratio) {
        return Err(layer.wrong("takes images of different sizes"));
    }
    Ok(images)
}

/// The result of a layer that takes images of one size and number of channels, and keeps both.
fn alike(layer: &Layer, blobs: &[&Blob]) -> Result<Blob, UpsamplerError> {
    let images = all_images(layer, blobs)?;
    let (channels, ratio, _) = images[0];
    if let Some((other, ..)) = images.iter().find(|(other, ..)| *other != channels) {
        return Err(layer.wrong(format!("takes {channels} channels and {other}")));
    }
    Ok(Blob::Images {
        channels,
        ratio,
        reach: images.iter().map(|(.., reach)| *reach).fold(0.0, f64::max),
    })
}

/// A convolution as it is computed, its channels and its kernel's side.
pub fn convolution(
    layer: &Layer,
    inputs: usize,
    parameters: &mut Parameters,
    weights: &mut Weights,
) -> Result<(Operation, usize, usize), UpsamplerError> {
    let outputs = parameters.count(0, 0)?;
    let side = parameters.count(1, 0)?;
    // An even kernel cannot keep the size with equal padding; the bound keeps products small.
    if side % 2 == 0 || side > 15 {
        return Err(layer.wrong(format!(
            "has a kernel of side {side}; supported are odd ones up to 15"
        )));
    }
    for (id, what, value) in [
        // In ncnn a height, dilation or stride that is not given down is as across.
        (11, "kernel's height", side),
        (2, "dilation", 1),
        (12, "dilation", 1),
        (3, "stride", 1),
        (13, "stride", 1),
        (8, "mark of 8-bit numbers", 0),
        (19, "mark of weights that are computed", 0),
    ] {
        parameters.must_be(id, what, value)?;
    }
    // What is not given on one side is as on the left.
    let left = parameters.count(4, 0)?;
    for id in [15, 14, 16] {
        parameters.must_be(id, "padding", left)?;
    }
    // Other padding would change the size, and tiles could not be put together.
    if left != side / 2 || parameters.number(18, 0.0)? != 0.0 {
        return Err(layer.wrong(format!(
            "pads {left} pixels around a kernel of {side}; supported are {} zeros",
            side / 2
        )));
    }
    let bias = parameters.count(5, 0)?;
    let size = parameters.count(6, 0)?;
    // Counts are a foreign file's, so the product is checked.
    let expected = outputs.checked_mul(inputs * side * side);
    if outputs == 0 || expected != Some(size) || bias > 1 {
        return Err(layer.wrong(format!(
            "says it has {size} weights, with {inputs} channels in, {outputs} out, and a kernel of {side}"
        )));
    }
    let function = parameters.count(9, 0)?;
    let list = parameters.list(10);
    let function = match (function, &list[..]) {
        (0, _) => Function::Same,
        // A ReLU is a leaky one of slope 0, which can be finished within the convolution.
        (1, []) => Function::Leaky(0.0),
        (2, [slope]) => Function::Leaky(*slope as f32),
        (3, [low, high]) if low <= high => Function::Clamp(*low as f32, *high as f32),
        (4, []) => Function::Sigmoid,
        _ => {
            return Err(layer.wrong(format!(
                "has the activation {function} with {list:?}, which is not known here"
            )));
        }
    };
    // In the order of the file: weights first, which may be halves, then the bias, always F32.
    let weight = weights.marked(layer, &[outputs, inputs, side, side])?;
    let bias = if bias == 1 {
        Some(weights.plain(layer, &[outputs])?)
    } else {
        None
    };
    Ok((
        Operation::Convolution(Convolution::new(weight, bias), function),
        outputs,
        side,
    ))
}

/// A function of two values, or of one and a number.
pub fn binary(
    layer: &Layer,
    blobs: &[&Blob],
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let kind = parameters.count(0, 0)?;
    let with_number = parameters.count(1, 0)?;
    let number = parameters.number(2, 0.0)? as f32;
    let unsupported = || {
        layer.wrong(format!(
            "computes the function {kind}, which is not known here for what it takes"
        ))
    };
    match (with_number, blobs) {
        (1, [blob @ Blob::Images { .. }]) => {
            let function = match kind {
                0 => Function::Offset(number),
                1 => Function::Offset(-number),
                2 => Function::Scale(number),
                3 if number != 0.0 => Function::Scale(1.0 / number),
                _ => return Err(unsupported()),
            };
            Ok((Operation::Function(function), (*blob).clone()))
        }
        // A mean per channel is stored as MemoryData; it becomes part of one addition.
        (0, [blob @ Blob::Images { channels, .. }, Blob::Constant(values)])
            if *channels == values.len() =>
        {
            let sign = match kind {
                0 => 1.0,
                1 => -1.0,
                _ => return Err(unsupported()),
            };
            Ok((
                Operation::Shift(values.iter().map(|value| sign * value).collect()),
                (*blob).clone(),
            ))
        }
        (0, [_, _]) => {
            let operation = match kind {
                0 => Operation::Sum(vec![1.0; 2]),
                1 => Operation::Difference,
                2 => Operation::Product,
                _ => return Err(unsupported()),
            };
            Ok((operation, alike(layer, blobs)?))
        }
        _ => Err(unsupported()),
    }
}

/// A function of all inputs.
pub fn eltwise(
    layer: &Layer,
    blobs: &[&Blob],
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let kind = parameters.count(0, 0)?;
    let factors = parameters.list(1);
    let operation = match kind {
        0 if factors.is_empty() => Operation::Product,
        1 if factors.is_empty() => Operation::Sum(vec![1.0; blobs.len()]),
        1 if factors.len() == blobs.len() => {
            Operation::Sum(factors.iter().map(|&factor| factor as f32).collect())
        }
        _ => {
            return Err(layer.wrong(format!(
                "computes the function {kind} with {factors:?}, which is not known here"
            )));
        }
    };
    Ok((operation, alike(layer, blobs)?))
}

/// An enlargement or reduction by a fixed ratio.
pub fn interp(
    layer: &Layer,
    (channels, ratio, reach): (usize, Ratio, f64),
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let kind = parameters.count(0, 0)?;
    let down = parameters.number(1, 1.0)?;
    let across = parameters.number(2, 1.0)?;
    for (id, what) in [
        (3, "height"),
        (4, "width"),
        (5, "mark of a size that is computed"),
        (6, "mark of aligned corners"),
    ] {
        parameters.must_be(id, what, 0)?;
    }
    // Unequal factors would need a reach and a ratio for each axis.
    let factor = Ratio::of(down).filter(|_| down == across);
    let result = factor.and_then(|factor| Some((factor, ratio.times(factor)?)));
    let Some((factor, larger)) = result else {
        return Err(layer.wrong(format!(
            "resizes by {down} and {across}; supported are equal ones of small numbers"
        )));
    };
    let (operation, pixels) = match (kind, factor.under) {
        // By a whole factor each pixel is repeated, and the reach does not grow.
        (1, 1) => (Operation::Nearest(factor.over), 0.0),
        (1, _) => (Operation::Resize(Filter::Nearest, factor), 1.0),
        (2, _) => (Operation::Resize(Filter::Bilinear, factor), 1.0),
        // Bicubic takes two pixels on each side; ncnn's has a = -0.75, as PyTorch's.
        (3, _) => (Operation::Resize(Filter::BicubicTorch, factor), 2.0),
        _ => return Err(layer.wrong(format!("resizes in the way {kind}; known are 1, 2 and 3"))),
    };
    let reach = reach + pixels / ratio.value();
    Ok((
        operation,
        Blob::Images {
            channels,
            ratio: larger,
            reach,
        },
    ))
}
