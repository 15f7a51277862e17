//! From the layers of a `.param` file, and the weights of its `.bin`, to a graph that can be computed: every layer,
//! parameter and size is checked here, so that nothing is left to go wrong later.

use std::collections::BTreeMap;

use compute::resize::Filter;

use super::blob::{Blob, Ratio, greatest_common_divisor};
use super::graph::{Graph, Step};
use super::layer::{Function, Operation};
use super::param::Layer;
use super::weights::Weights;
use crate::convolution::Convolution;
use crate::error::UpsamplerError;
use crate::network::Facts;

/// More channels than any network has.
const CHANNELS: usize = 1 << 16;
/// The largest factor of a shuffle.
const FACTOR: usize = 16;

/// The parameters of a layer that have not been looked at.
struct Parameters<'a> {
    layer: &'a Layer,
    left: BTreeMap<u32, Vec<f64>>,
}

impl<'a> Parameters<'a> {
    fn of(layer: &'a Layer) -> Self {
        Self { layer, left: layer.parameters.clone() }
    }

    fn number(&mut self, id: u32, default: f64) -> Result<f64, UpsamplerError> {
        match self.left.remove(&id).as_deref() {
            None => Ok(default),
            Some(&[value]) => Ok(value),
            Some(_) => Err(self.layer.wrong(format!("has a list as its parameter {id}"))),
        }
    }

    /// A whole number from 0 on.
    fn count(&mut self, id: u32, default: usize) -> Result<usize, UpsamplerError> {
        let value = self.number(id, default as f64)?;
        let whole = value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value);
        if whole { Ok(value as usize) } else { Err(self.layer.wrong(format!("has {value} as its parameter {id}"))) }
    }

    fn list(&mut self, id: u32) -> Vec<f64> {
        self.left.remove(&id).unwrap_or_default()
    }

    /// Refuses any other value of a parameter than this one.
    fn must_be(&mut self, id: u32, what: &str, value: usize) -> Result<(), UpsamplerError> {
        let given = self.number(id, value as f64)?;
        if given == value as f64 {
            return Ok(());
        }
        Err(self.layer.wrong(format!("has {given} as its {what} (parameter {id}); supported is {value}")))
    }

    /// Refuses parameters that nothing has looked at, unless they are 0 and so, in ncnn, as if they were not there.
    fn finish(self) -> Result<(), UpsamplerError> {
        match self.left.iter().find(|(_, values)| values.iter().any(|&value| value != 0.0)) {
            Some((id, values)) => {
                Err(self.layer.wrong(format!("has the parameter {id}={values:?}, which is not known here")))
            }
            None => Ok(()),
        }
    }
}

/// The values that have been named so far.
struct Builder {
    steps: Vec<Step>,
    /// For each name, the value's number, if it is computed, and what is known of it.
    blobs: BTreeMap<String, (usize, Blob)>,
    /// Names that no layer has taken yet.
    loose: Vec<String>,
    width: usize,
    convolutions: usize,
    /// The most numbers that a value has per pixel of the input.
    largest: f64,
    grain: usize,
}

/// The graph of these layers, with their weights.
pub fn build(layers: &[Layer], weights: &mut Weights) -> Result<Graph, UpsamplerError> {
    let Some(first) = layers.first() else {
        return Err(UpsamplerError::file("", "a graph without layers"));
    };
    let mut builder = Builder {
        steps: Vec::new(),
        blobs: BTreeMap::new(),
        loose: Vec::new(),
        width: 0,
        convolutions: 0,
        largest: 0.0,
        grain: 1,
    };
    if first.kind != "Input" {
        return Err(first.wrong("is the first; a graph begins with its Input"));
    }
    for (number, layer) in layers.iter().enumerate() {
        if layer.kind == "Input" && number > 0 {
            return Err(layer.wrong("is a second input; supported is one image"));
        }
        builder.layer(layer, weights)?;
    }
    builder.finish(&layers[layers.len() - 1])
}

impl Builder {
    fn layer(&mut self, layer: &Layer, weights: &mut Weights) -> Result<(), UpsamplerError> {
        let taken = layer.inputs.iter().map(|name| self.take(layer, name)).collect::<Result<Vec<_>, _>>()?;
        let mut parameters = Parameters::of(layer);
        match layer.kind.as_str() {
            "Input" => {
                let ([], [name]) = (&taken[..], &layer.outputs[..]) else {
                    return Err(layer.wrong("takes nothing and gives one blob"));
                };
                // Height, width and channels of the image that it was converted with.
                (parameters.count(0, 0)?, parameters.count(1, 0)?);
                parameters.must_be(2, "number of channels", 3)?;
                self.name(layer, name, 0, Blob::Images { channels: 3, ratio: Ratio::ONE, reach: 0.0 })?;
            }
            "MemoryData" => {
                let ([], [name]) = (&taken[..], &layer.outputs[..]) else {
                    return Err(layer.wrong("takes nothing and gives one blob"));
                };
                parameters.must_be(0, "width", 1)?;
                parameters.must_be(1, "height", 1)?;
                let channels = parameters.count(2, 0)?;
                let values = weights.plain(layer, &[channels])?.to_vec();
                self.name(layer, name, 0, Blob::Constant(values))?;
            }
            "Split" => {
                let [(value, blob)] = &taken[..] else { return Err(layer.wrong("takes one blob")) };
                for name in &layer.outputs {
                    self.name(layer, name, *value, blob.clone())?;
                }
            }
            _ => {
                let [name] = &layer.outputs[..] else { return Err(layer.wrong("gives one blob")) };
                let (operation, blob) = self.operation(layer, &taken, &mut parameters, weights)?;
                let images = taken.iter().filter(|(_, blob)| matches!(blob, Blob::Images { .. }));
                self.steps.push(Step { operation, inputs: images.map(|(value, _)| *value).collect() });
                self.name(layer, name, self.steps.len(), blob)?;
            }
        }
        parameters.finish()
    }

    fn take(&mut self, layer: &Layer, name: &str) -> Result<(usize, Blob), UpsamplerError> {
        self.loose.retain(|loose| loose != name);
        let found = self.blobs.get(name).cloned();
        found.ok_or_else(|| layer.wrong(format!("takes `{name}`, which no layer before it gives")))
    }

    fn name(&mut self, layer: &Layer, name: &str, value: usize, blob: Blob) -> Result<(), UpsamplerError> {
        if let Blob::Images { channels, ratio, .. } = &blob {
            if *channels == 0 || *channels > CHANNELS {
                return Err(layer.wrong(format!("gives {channels} channels")));
            }
            self.width = self.width.max(*channels);
            self.largest = self.largest.max(*channels as f64 * ratio.value() * ratio.value());
            self.grain = self.grain / greatest_common_divisor(self.grain, ratio.under) * ratio.under;
            if self.grain > FACTOR {
                return Err(layer.wrong("makes images too small to be enlarged"));
            }
        }
        self.loose.push(name.to_owned());
        match self.blobs.insert(name.to_owned(), (value, blob)) {
            Some(_) => Err(layer.wrong(format!("gives `{name}`, which another layer has given"))),
            None => Ok(()),
        }
    }

    /// The layer as it is computed, and what is known of its result.
    fn operation(
        &mut self,
        layer: &Layer,
        taken: &[(usize, Blob)],
        parameters: &mut Parameters,
        weights: &mut Weights,
    ) -> Result<(Operation, Blob), UpsamplerError> {
        let blobs: Vec<&Blob> = taken.iter().map(|(_, blob)| blob).collect();
        match (layer.kind.as_str(), &blobs[..]) {
            ("BinaryOp", _) => binary(layer, &blobs, parameters),
            ("Eltwise", _) => eltwise(layer, &blobs, parameters),
            ("Concat", _) => {
                parameters.must_be(0, "axis", 0)?;
                let images = all_images(layer, &blobs)?;
                let channels = images.iter().map(|(channels, ..)| channels).sum();
                let reach = images.iter().map(|(.., reach)| *reach).fold(0.0, f64::max);
                Ok((Operation::Concat, Blob::Images { channels, ratio: images[0].1, reach }))
            }
            (_, &[&Blob::Images { channels, ratio, reach }]) => {
                let same = |operation| Ok((operation, Blob::Images { channels, ratio, reach }));
                match layer.kind.as_str() {
                    "Convolution" => {
                        let (operation, outputs, side) = convolution(layer, channels, parameters, weights)?;
                        self.convolutions += 1;
                        let reach = reach + (side / 2) as f64 / ratio.value();
                        Ok((operation, Blob::Images { channels: outputs, ratio, reach }))
                    }
                    "ReLU" => same(Operation::Function(Function::Leaky(parameters.number(0, 0.0)? as f32))),
                    "Sigmoid" => same(Operation::Function(Function::Sigmoid)),
                    "Swish" => same(Operation::Function(Function::Swish)),
                    "Clip" => {
                        let [low, high] =
                            [parameters.number(0, f64::from(f32::MIN))?, parameters.number(1, f64::from(f32::MAX))?];
                        if low > high {
                            return Err(layer.wrong(format!("leaves nothing between {low} and {high}")));
                        }
                        same(Operation::Function(Function::Clamp(low as f32, high as f32)))
                    }
                    "PReLU" => match parameters.count(0, 0)? {
                        1 => {
                            let slope = weights.plain(layer, &[1])?.to_vec()[0];
                            same(Operation::Function(Function::Leaky(slope)))
                        }
                        count if count == channels => same(Operation::Prelu(weights.plain(layer, &[count])?)),
                        count => Err(layer.wrong(format!("has {count} slopes for {channels} channels"))),
                    },
                    "PixelShuffle" => {
                        let factor = parameters.count(0, 1)?;
                        parameters.must_be(1, "mode", 0)?;
                        let whole = (1..=FACTOR).contains(&factor) && channels % (factor * factor) == 0;
                        let larger = Ratio::new(factor, 1).and_then(|factor| ratio.times(factor));
                        let (true, Some(ratio)) = (whole, larger) else {
                            return Err(layer.wrong(format!("shuffles {channels} channels by {factor}")));
                        };
                        let channels = channels / (factor * factor);
                        Ok((Operation::Shuffle(factor), Blob::Images { channels, ratio, reach }))
                    }
                    "Reorg" => {
                        let factor = parameters.count(0, 1)?;
                        parameters.must_be(1, "mode", 0)?;
                        let smaller = Ratio::new(1, factor).and_then(|factor| ratio.times(factor));
                        let (true, Some(smaller)) = ((1..=FACTOR).contains(&factor), smaller) else {
                            return Err(layer.wrong(format!("reorders by {factor}")));
                        };
                        let (channels, reach) = (channels * factor * factor, reach + factor as f64 / ratio.value());
                        Ok((Operation::Unshuffle(factor), Blob::Images { channels, ratio: smaller, reach }))
                    }
                    "Interp" => interp(layer, [channels as f64, reach], ratio, parameters),
                    _ => Err(unknown(layer)),
                }
            }
            _ => Err(unknown(layer)),
        }
    }

    fn finish(self, last: &Layer) -> Result<Graph, UpsamplerError> {
        let [output] = &self.loose[..] else {
            let names = self.loose.join("`, `");
            return Err(last.wrong(format!("is the last, and nothing takes `{names}`; supported is one result")));
        };
        let scale = match self.blobs.get(output) {
            Some((value, Blob::Images { channels: 3, ratio: Ratio { over, under: 1 }, .. }))
                if *value == self.steps.len() && *value > 0 =>
            {
                *over
            }
            Some((_, Blob::Images { channels, ratio, .. })) => {
                let Ratio { over, under } = ratio;
                let problem = format!(
                    "gives the result, {channels} channels of {over}/{under} times the side; expected are 3, enlarged by a whole number"
                );
                return Err(last.wrong(problem));
            }
            _ => return Err(last.wrong("is the last, and there are no images")),
        };
        let Some((_, Blob::Images { reach, .. })) = self.blobs.get(output) else {
            return Err(last.wrong("is the last, and there are no images"));
        };
        let facts = Facts {
            family: "ncnn graph",
            scale,
            width: self.width,
            depth: format!("{} convolutions", self.convolutions),
            reach: reach.ceil() as usize,
            grain: self.grain,
            bytes_per_pixel: (4.0 * 6.0 * self.largest) as usize,
        };
        Ok(Graph::new(self.steps, facts))
    }
}

fn unknown(layer: &Layer) -> UpsamplerError {
    layer.wrong(format!("with {} inputs is of a kind that is not known here", layer.inputs.len()))
}

/// The facts of all inputs, which are images of one size.
fn all_images(layer: &Layer, blobs: &[&Blob]) -> Result<Vec<(usize, Ratio, f64)>, UpsamplerError> {
    let facts = |blob: &&Blob| match blob {
        Blob::Images { channels, ratio, reach } => Ok((*channels, *ratio, *reach)),
        Blob::Constant(_) => Err(layer.wrong("takes a constant where it should take images")),
    };
    let images = blobs.iter().map(facts).collect::<Result<Vec<_>, _>>()?;
    let [(_, ratio, _), ..] = &images[..] else { return Err(layer.wrong("takes nothing")) };
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
    Ok(Blob::Images { channels, ratio, reach: images.iter().map(|(.., reach)| *reach).fold(0.0, f64::max) })
}

fn convolution(
    layer: &Layer,
    inputs: usize,
    parameters: &mut Parameters,
    weights: &mut Weights,
) -> Result<(Operation, usize, usize), UpsamplerError> {
    let (outputs, side) = (parameters.count(0, 0)?, parameters.count(1, 0)?);
    if side % 2 == 0 || side > 15 {
        return Err(layer.wrong(format!("has a kernel of side {side}; supported are odd ones up to 15")));
    }
    for (id, what, value) in [
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
    if left != side / 2 || parameters.number(18, 0.0)? != 0.0 {
        return Err(
            layer.wrong(format!("pads {left} pixels around a kernel of {side}; supported are {} zeros", side / 2))
        );
    }
    let (bias, size) = (parameters.count(5, 0)?, parameters.count(6, 0)?);
    let expected = outputs.checked_mul(inputs * side * side);
    if outputs == 0 || expected != Some(size) || bias > 1 {
        return Err(layer.wrong(format!(
            "says it has {size} weights, with {inputs} channels in, {outputs} out, and a kernel of {side}"
        )));
    }
    let (function, list) = (parameters.count(9, 0)?, parameters.list(10));
    let function = match (function, &list[..]) {
        (0, _) => Function::Same,
        (1, []) => Function::Leaky(0.0),
        (2, [slope]) => Function::Leaky(*slope as f32),
        (3, [low, high]) if low <= high => Function::Clamp(*low as f32, *high as f32),
        (4, []) => Function::Sigmoid,
        _ => return Err(layer.wrong(format!("has the activation {function} with {list:?}, which is not known here"))),
    };
    let weight = weights.marked(layer, &[outputs, inputs, side, side])?;
    let bias = if bias == 1 { Some(weights.plain(layer, &[outputs])?) } else { None };
    Ok((Operation::Convolution(Convolution::new(weight, bias), function), outputs, side))
}

fn binary(layer: &Layer, blobs: &[&Blob], parameters: &mut Parameters) -> Result<(Operation, Blob), UpsamplerError> {
    let kind = parameters.count(0, 0)?;
    let (with_number, number) = (parameters.count(1, 0)?, parameters.number(2, 0.0)? as f32);
    let unsupported =
        || layer.wrong(format!("computes the function {kind}, which is not known here for what it takes"));
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
        (0, [blob @ Blob::Images { channels, .. }, Blob::Constant(values)]) if *channels == values.len() => {
            let sign = match kind {
                0 => 1.0,
                1 => -1.0,
                _ => return Err(unsupported()),
            };
            Ok((Operation::Shift(values.iter().map(|value| sign * value).collect()), (*blob).clone()))
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

fn eltwise(layer: &Layer, blobs: &[&Blob], parameters: &mut Parameters) -> Result<(Operation, Blob), UpsamplerError> {
    let (kind, factors) = (parameters.count(0, 0)?, parameters.list(1));
    let operation = match kind {
        0 if factors.is_empty() => Operation::Product,
        1 if factors.is_empty() => Operation::Sum(vec![1.0; blobs.len()]),
        1 if factors.len() == blobs.len() => Operation::Sum(factors.iter().map(|&factor| factor as f32).collect()),
        _ => return Err(layer.wrong(format!("computes the function {kind} with {factors:?}, which is not known here"))),
    };
    Ok((operation, alike(layer, blobs)?))
}

fn interp(
    layer: &Layer,
    [channels, reach]: [f64; 2],
    ratio: Ratio,
    parameters: &mut Parameters,
) -> Result<(Operation, Blob), UpsamplerError> {
    let (kind, down, across) = (parameters.count(0, 0)?, parameters.number(1, 1.0)?, parameters.number(2, 1.0)?);
    for (id, what) in
        [(3, "height"), (4, "width"), (5, "mark of a size that is computed"), (6, "mark of aligned corners")]
    {
        parameters.must_be(id, what, 0)?;
    }
    let factor = Ratio::of(down).filter(|_| down == across);
    let result = factor.and_then(|factor| Some((factor, ratio.times(factor)?)));
    let Some((factor, larger)) = result else {
        return Err(layer.wrong(format!("resizes by {down} and {across}; supported are equal ones of small numbers")));
    };
    let (operation, pixels) = match (kind, factor.under) {
        (1, 1) => (Operation::Nearest(factor.over), 0.0),
        (1, _) => (Operation::Resize(Filter::Nearest, factor), 1.0),
        (2, _) => (Operation::Resize(Filter::Bilinear, factor), 1.0),
        (3, _) => (Operation::Resize(Filter::BicubicTorch, factor), 2.0),
        _ => return Err(layer.wrong(format!("resizes in the way {kind}; known are 1, 2 and 3"))),
    };
    let reach = reach + pixels / ratio.value();
    Ok((operation, Blob::Images { channels: channels as usize, ratio: larger, reach }))
}
