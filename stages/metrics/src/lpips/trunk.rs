//! The trunks that LPIPS looks through, as torchvision and `stlpips-pytorch` have them: which
//! layers, in which slices, under which names. Knows nothing of distances.

use compute::activation::relu;
use compute::conv::{Conv, conv2d};
use compute::shape::concat;
use compute::{Array, Device};
use formats::tensor_file::{TensorError, TensorFile};

use super::pool::{blurred, largest};

/// A step of a slice. `at` is a layer's number in torchvision's `features`, which its name has.
pub enum Step {
    /// A convolution `[outputs, inputs, side]` with bias.
    Conv {
        at: usize,
        shape: [usize; 3],
        stride: usize,
        pad: usize,
    },
    /// max(x, 0).
    Relu,
    /// The largest of a window of this side, so far apart; the last one may hang over the edge.
    Largest {
        side: usize,
        stride: usize,
        up: bool,
    },
    /// A blur that keeps every second pixel.
    Blurred,
    /// SqueezeNet's module: to `squeezed` channels, and from these to twice `expanded`, half by
    /// 1x1 and half by 3x3 kernels.
    Fire {
        at: usize,
        inputs: usize,
        squeezed: usize,
        expanded: usize,
    },
}

/// A known network.
pub struct Network {
    /// Of the column.
    pub name: &'static str,
    /// A tensor that no other network has.
    pub sign: &'static str,
    /// Channels after each slice.
    pub channels: &'static [usize],
    /// What happens in each.
    slices: &'static [&'static [Step]],
}

/// A convolution of stride 1 that keeps the size.
const fn same(at: usize, shape: [usize; 3]) -> Step {
    Step::Conv {
        at,
        shape,
        stride: 1,
        pad: shape[2] / 2,
    }
}

const fn first(shape: [usize; 3], stride: usize, pad: usize) -> Step {
    Step::Conv {
        at: 0,
        shape,
        stride,
        pad,
    }
}

const fn down(side: usize, stride: usize) -> Step {
    Step::Largest {
        side,
        stride,
        up: false,
    }
}

/// SqueezeNet's.
const POOL: Step = Step::Largest {
    side: 3,
    stride: 2,
    up: true,
};

const fn fire(at: usize, inputs: usize, squeezed: usize, expanded: usize) -> Step {
    Step::Fire {
        at,
        inputs,
        squeezed,
        expanded,
    }
}

use Step::{Blurred, Relu};

/// All that are known. The shift-tolerant ones blur wherever they halve, and halve by nothing else.
pub const NETWORKS: [Network; 5] = [
    Network {
        name: "lpips_alex",
        sign: "net.slice5.10.weight",
        channels: &[64, 192, 384, 256, 256],
        slices: &[
            &[first([64, 3, 11], 4, 2), Relu],
            &[down(3, 2), same(3, [192, 64, 5]), Relu],
            &[down(3, 2), same(6, [384, 192, 3]), Relu],
            &[same(8, [256, 384, 3]), Relu],
            &[same(10, [256, 256, 3]), Relu],
        ],
    },
    Network {
        name: "lpips_vgg",
        sign: "net.slice5.24.weight",
        channels: &[64, 128, 256, 512, 512],
        slices: &[
            &[same(0, [64, 3, 3]), Relu, same(2, [64, 64, 3]), Relu],
            &[
                down(2, 2),
                same(5, [128, 64, 3]),
                Relu,
                same(7, [128, 128, 3]),
                Relu,
            ],
            &[
                down(2, 2),
                same(10, [256, 128, 3]),
                Relu,
                same(12, [256, 256, 3]),
                Relu,
                same(14, [256, 256, 3]),
                Relu,
            ],
            &[
                down(2, 2),
                same(17, [512, 256, 3]),
                Relu,
                same(19, [512, 512, 3]),
                Relu,
                same(21, [512, 512, 3]),
                Relu,
            ],
            &[
                down(2, 2),
                same(24, [512, 512, 3]),
                Relu,
                same(26, [512, 512, 3]),
                Relu,
                same(28, [512, 512, 3]),
                Relu,
            ],
        ],
    },
    Network {
        name: "lpips_squeeze",
        sign: "net.slice7.12.squeeze.weight",
        channels: &[64, 128, 256, 384, 384, 512, 512],
        slices: &[
            &[first([64, 3, 3], 2, 0), Relu],
            &[POOL, fire(3, 64, 16, 64), fire(4, 128, 16, 64)],
            &[POOL, fire(6, 128, 32, 128), fire(7, 256, 32, 128)],
            &[POOL, fire(9, 256, 48, 192)],
            &[fire(10, 384, 48, 192)],
            &[fire(11, 384, 64, 256)],
            &[fire(12, 512, 64, 256)],
        ],
    },
    Network {
        name: "stlpips_alex",
        sign: "net.slice5.13.weight",
        channels: &[64, 192, 384, 256, 256],
        slices: &[
            &[first([64, 3, 11], 1, 2), Blurred, Relu],
            &[down(3, 1), Blurred, same(5, [192, 64, 5]), Relu],
            &[down(3, 1), Blurred, same(9, [384, 192, 3]), Relu],
            &[same(11, [256, 384, 3]), Relu],
            &[same(13, [256, 256, 3]), Relu],
        ],
    },
    Network {
        name: "stlpips_vgg",
        sign: "net.slice5.32.weight",
        channels: &[64, 128, 256, 512, 512],
        slices: &[
            &[same(0, [64, 3, 3]), Relu, same(2, [64, 64, 3]), Relu],
            &[
                down(2, 1),
                Blurred,
                same(6, [128, 64, 3]),
                Relu,
                same(8, [128, 128, 3]),
                Relu,
            ],
            &[
                down(2, 1),
                Blurred,
                same(12, [256, 128, 3]),
                Relu,
                same(14, [256, 256, 3]),
                Relu,
                same(16, [256, 256, 3]),
                Relu,
            ],
            &[
                down(2, 1),
                Blurred,
                same(20, [512, 256, 3]),
                Relu,
                same(22, [512, 512, 3]),
                Relu,
                same(24, [512, 512, 3]),
                Relu,
            ],
            &[
                down(2, 1),
                Blurred,
                same(28, [512, 512, 3]),
                Relu,
                same(30, [512, 512, 3]),
                Relu,
                same(32, [512, 512, 3]),
                Relu,
            ],
        ],
    },
];

/// The weights of a trunk, step by step.
pub struct Trunk {
    slices: Vec<Vec<Layer>>,
}

/// A step with its weights.
enum Layer {
    Conv(Convolution),
    Fire(Box<[Convolution; 3]>),
    Plain(&'static Step),
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
        network: &'static Network,
        file: &TensorFile,
        device: &Device,
    ) -> Result<Self, TensorError> {
        let slice = |(number, steps): (usize, &&'static [Step])| {
            let layers = steps.iter();
            layers
                .map(|step| layer(step, &format!("net.slice{}", number + 1), file, device))
                .collect::<Result<Vec<_>, _>>()
        };
        let slices = network.slices.iter().enumerate();
        Ok(Self {
            slices: slices.map(slice).collect::<Result<_, _>>()?,
        })
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

fn layer(
    step: &'static Step,
    slice: &str,
    file: &TensorFile,
    device: &Device,
) -> Result<Layer, TensorError> {
    let read = |name: String, shape, conv| Convolution::read(file, &name, shape, conv, device);
    Ok(match *step {
        Step::Conv {
            at,
            shape,
            stride,
            pad,
        } => {
            let conv = Conv {
                stride,
                pad: [pad; 4],
            };
            Layer::Conv(read(format!("{slice}.{at}"), shape, conv)?)
        }
        Step::Fire {
            at,
            inputs,
            squeezed,
            expanded,
        } => {
            let name = |part: &str| format!("{slice}.{at}.{part}");
            Layer::Fire(Box::new([
                read(name("squeeze"), [squeezed, inputs, 1], Conv::default())?,
                read(name("expand1x1"), [expanded, squeezed, 1], Conv::default())?,
                read(name("expand3x3"), [expanded, squeezed, 3], Conv::padded(1))?,
            ]))
        }
        Step::Relu | Step::Largest { .. } | Step::Blurred => Layer::Plain(step),
    })
}

impl Layer {
    fn apply(&self, x: &Array) -> Array {
        match self {
            Self::Conv(convolution) => convolution.apply(x),
            Self::Fire(parts) => {
                let [squeeze, expand_1, expand_3] = parts.as_ref();
                let x = relu(&squeeze.apply(x));
                let [a, b] = [expand_1, expand_3].map(|expand| relu(&expand.apply(&x)));
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
    if tensor.shape != shape {
        let problem = format!("has the shape {:?}; expected {shape:?}", tensor.shape);
        return Err(TensorError::tensor(file.name(), name, problem));
    }
    Ok(tensor.values)
}
