//! From the layers of a `.param` file, and the weights of its `.bin`, to a graph that can be
//! computed: every layer, parameter and size is checked here, so that nothing is left to go wrong
//! later.

use std::collections::BTreeMap;

use super::activation::activation;
use super::blob::{Blob, Ratio, greatest_common_divisor};
use super::graph::{Graph, Step};
use super::kinds::{all_images, binary, convolution, eltwise, interp, unknown};
use super::layer::Operation;
use super::param::Layer;
use super::parameters::Parameters;
use super::shuffle::{FACTOR, shuffle, unshuffle};
use super::weights::Weights;
use crate::error::UpsamplerError;
use crate::network::Facts;

/// More channels than any network has.
const CHANNELS: usize = 1 << 16;

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
    // The file is foreign. What is checked here cannot panic while a tile is computed.
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
        let taken = layer
            .inputs
            .iter()
            .map(|name| self.take(layer, name))
            .collect::<Result<Vec<_>, _>>()?;
        let mut parameters = Parameters::of(layer);
        match layer.kind.as_str() {
            "Input" => {
                let ([], [name]) = (&taken[..], &layer.outputs[..]) else {
                    return Err(layer.wrong("takes nothing and gives one blob"));
                };
                // Height, width and channels of the image that it was converted with.
                // Read so that they count as known; the graph itself fits any size.
                parameters.count(0, 0)?;
                parameters.count(1, 0)?;
                parameters.must_be(2, "number of channels", 3)?;
                self.name(
                    layer,
                    name,
                    0,
                    Blob::Images {
                        channels: 3,
                        ratio: Ratio::ONE,
                        reach: 0.0,
                    },
                )?;
            }
            "MemoryData" => {
                let ([], [name]) = (&taken[..], &layer.outputs[..]) else {
                    return Err(layer.wrong("takes nothing and gives one blob"));
                };
                // One number per channel is all that the known networks need of it.
                parameters.must_be(0, "width", 1)?;
                parameters.must_be(1, "height", 1)?;
                let channels = parameters.count(2, 0)?;
                let values = weights.plain(layer, &[channels])?.to_vec();
                self.name(layer, name, 0, Blob::Constant(values))?;
            }
            "Split" => {
                let [(value, blob)] = &taken[..] else {
                    return Err(layer.wrong("takes one blob"));
                };
                // A Split copies nothing: all names stand for the same value.
                for name in &layer.outputs {
                    self.name(layer, name, *value, blob.clone())?;
                }
            }
            _ => {
                let [name] = &layer.outputs[..] else {
                    return Err(layer.wrong("gives one blob"));
                };
                let (operation, blob) = self.operation(layer, &taken, &mut parameters, weights)?;
                let images = taken
                    .iter()
                    .filter(|(_, blob)| matches!(blob, Blob::Images { .. }));
                self.steps.push(Step {
                    operation,
                    // A constant becomes part of its operation, so steps take images only.
                    inputs: images.map(|(value, _)| *value).collect(),
                });
                self.name(layer, name, self.steps.len(), blob)?;
            }
        }
        parameters.finish()
    }

    fn take(&mut self, layer: &Layer, name: &str) -> Result<(usize, Blob), UpsamplerError> {
        // What is left at the end is the result, and there may be one.
        self.loose.retain(|loose| loose != name);
        let found = self.blobs.get(name).cloned();
        found.ok_or_else(|| layer.wrong(format!("takes `{name}`, which no layer before it gives")))
    }

    fn name(
        &mut self,
        layer: &Layer,
        name: &str,
        value: usize,
        blob: Blob,
    ) -> Result<(), UpsamplerError> {
        if let Blob::Images {
            channels, ratio, ..
        } = &blob
        {
            // The bound keeps products of counts from a foreign file within `usize`.
            if *channels == 0 || *channels > CHANNELS {
                return Err(layer.wrong(format!("gives {channels} channels")));
            }
            self.width = self.width.max(*channels);
            // Per pixel of the input, by which a tile's memory is counted.
            self.largest = self
                .largest
                .max(*channels as f64 * ratio.value() * ratio.value());
            self.grain =
                // The least common multiple: sides must divide by all that shrinks.
                self.grain / greatest_common_divisor(self.grain, ratio.under) * ratio.under;
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
                Ok((
                    Operation::Concat,
                    Blob::Images {
                        channels,
                        ratio: images[0].1,
                        reach,
                    },
                ))
            }
            (
                _,
                &[
                    &Blob::Images {
                        channels,
                        ratio,
                        reach,
                    },
                ],
            ) => {
                let images = (channels, ratio, reach);
                match layer.kind.as_str() {
                    "Convolution" => {
                        let (operation, outputs, side) =
                            convolution(layer, channels, parameters, weights)?;
                        self.convolutions += 1;
                        // Half a kernel, over the ratio: reach is counted in pixels of the input.
                        let reach = reach + (side / 2) as f64 / ratio.value();
                        Ok((
                            operation,
                            Blob::Images {
                                channels: outputs,
                                ratio,
                                reach,
                            },
                        ))
                    }
                    "ReLU" | "Sigmoid" | "Swish" | "Clip" | "PReLU" => Ok((
                        activation(layer, channels, parameters, weights)?,
                        blobs[0].clone(),
                    )),
                    "PixelShuffle" => shuffle(layer, images, parameters),
                    "Reorg" => unshuffle(layer, images, parameters),
                    "Interp" => interp(layer, images, parameters),
                    _ => Err(unknown(layer)),
                }
            }
            _ => Err(unknown(layer)),
        }
    }

    fn finish(self, last: &Layer) -> Result<Graph, UpsamplerError> {
        // With two results it is not known which one is the enlarged image.
        let [output] = &self.loose[..] else {
            let names = self.loose.join("`, `");
            return Err(last.wrong(format!(
                "is the last, and nothing takes `{names}`; supported is one result"
            )));
        };
        // The result must be the last value, which is what `Graph::forward` returns.
        let scale = match self.blobs.get(output) {
            Some((
                value,
                Blob::Images {
                    channels: 3,
                    ratio: Ratio { over, under: 1 },
                    ..
                },
            )) if *value == self.steps.len() && *value > 0 => *over,
            Some((
                _,
                Blob::Images {
                    channels, ratio, ..
                },
            )) => {
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
            // Four bytes a number, and about four values of the widest kind at once.
            bytes_per_pixel: (4.0 * 4.0 * self.largest) as usize,
        };
        Ok(Graph::new(self.steps, facts))
    }
}
