//! A network with its weights: reads them by torchvision's names, and runs it. Knows nothing of
//! distances.

use compute::activation::relu;
use compute::conv::{Conv, conv2d};
use compute::shape::concat;
use compute::{Array, Device};
use formats::tensor_file::{TensorError, TensorFile};

use super::network::{Network, Step};
use super::pool::{blurred, largest};

/// The weights of a trunk, step by step.
pub struct Trunk {
    slices: Vec<Vec<Layer>>,
    /// Channels behind each slice.
    pub channels: Vec<usize>,
}

/// A step with its weights.
enum Layer {
    Conv(Convolution),
    Fire(Box<[Convolution; 3]>),
    Plain(Step),
}

struct Convolution {
    weight: Array,
    bias: Array,
    conv: Conv,
}

impl Convolution {
    /// The convolution `[outputs, inputs, side]` of this name.
    fn read(
        file: &TensorFile,
        name: &str,
        [outputs, inputs, side]: [usize; 3],
        conv: Conv,
        device: &Device,
    ) -> Result<Self, TensorError> {
        let shape = [outputs, inputs, side, side];
        let weight = tensor(file, &format!("{name}.weight"), &shape)?;
        let bias = tensor(file, &format!("{name}.bias"), &[outputs])?;
        Ok(Self {
            weight: device.array(&shape, weight),
            bias: device.array(&[outputs], bias),
            conv,
        })
    }

    fn apply(&self, x: &Array) -> Array {
        conv2d(x, &self.weight, Some(&self.bias), self.conv)
    }
}

impl Trunk {
    /// The trunk of a network, from the file of its state.
    pub fn read(
        network: &Network,
        file: &TensorFile,
        device: &Device,
    ) -> Result<Self, TensorError> {
        let mut trunk = Self {
            slices: Vec::new(),
            channels: Vec::new(),
        };
        // A step's name has its place among the steps of all slices.
        let mut at = 0;
        let mut channels = 3;
        for (slice, steps) in (network.slices)().into_iter().enumerate() {
            let mut layers = Vec::with_capacity(steps.len());
            for step in steps {
                let name = format!("net.slice{}.{at}", slice + 1);
                layers.push(Layer::read(step, &name, channels, file, device)?);
                channels = step.outputs(channels);
                at += 1;
            }
            trunk.slices.push(layers);
            trunk.channels.push(channels);
        }
        Ok(trunk)
    }

    /// `x [1, 3, H, W]` after each slice.
    pub fn slices(&self, x: &Array) -> Vec<Array> {
        let mut x = x.clone();
        let mut after = Vec::with_capacity(self.slices.len());
        for slice in &self.slices {
            x = slice.iter().fold(x, |x, layer| layer.apply(&x));
            after.push(x.clone());
        }
        after
    }
}

impl Layer {
    /// The step of this name, whose input has so many channels.
    fn read(
        step: Step,
        name: &str,
        inputs: usize,
        file: &TensorFile,
        device: &Device,
    ) -> Result<Self, TensorError> {
        let read = |name: &str, shape, conv| Convolution::read(file, name, shape, conv, device);
        Ok(match step {
            Step::Conv {
                outputs,
                side,
                stride,
                pad,
            } => {
                let pad = [pad; 4];
                Self::Conv(read(name, [outputs, inputs, side], Conv { stride, pad })?)
            }
            Step::Fire { squeezed, expanded } => {
                let part = |part: &str, shape, pad| {
                    read(&format!("{name}.{part}"), shape, Conv::padded(pad))
                };
                Self::Fire(Box::new([
                    part("squeeze", [squeezed, inputs, 1], 0)?,
                    part("expand1x1", [expanded, squeezed, 1], 0)?,
                    // Padded by 1, so that both halves have the same size and can be joined.
                    part("expand3x3", [expanded, squeezed, 3], 1)?,
                ]))
            }
            Step::Relu | Step::Largest { .. } | Step::Blurred => Self::Plain(step),
        })
    }

    fn apply(&self, x: &Array) -> Array {
        match self {
            Self::Conv(convolution) => convolution.apply(x),
            Self::Fire(parts) => {
                let [squeeze, expand_1, expand_3] = parts.as_ref();
                // SqueezeNet's module has its ReLUs inside: they do not count as steps.
                let x = relu(&squeeze.apply(x));
                let [a, b] = [expand_1, expand_3].map(|expand| relu(&expand.apply(&x)));
                // 1x1 first: the next kernel's input channels are in this order.
                concat(&[&a, &b], 1)
            }
            Self::Plain(Step::Largest { side, stride, up }) => largest(x, *side, *stride, *up),
            Self::Plain(Step::Blurred) => blurred(x),
            Self::Plain(_) => relu(x),
        }
    }
}

/// The values of a tensor of exactly this shape.
pub fn tensor(file: &TensorFile, name: &str, shape: &[usize]) -> Result<Vec<f32>, TensorError> {
    let tensor = file.tensor(name)?;
    // The file is foreign. Further on, a wrong shape would panic, or a head be cut short by `zip`.
    if tensor.shape != shape {
        let problem = format!("has the shape {:?}; expected {shape:?}", tensor.shape);
        return Err(TensorError::tensor(file.name(), name, problem));
    }
    Ok(tensor.values)
}
