//! The networks that LPIPS looks through, as torchvision and `stlpips-pytorch` have them: which
//! steps, in which slices. Knows no weights.

use Step::{Blurred, Relu};

/// A step of a network.
#[derive(Clone, Copy)]
pub enum Step {
    /// A convolution with bias.
    Conv {
        outputs: usize,
        side: usize,
        stride: usize,
        pad: usize,
    },
    /// max(x, 0), element by element.
    Relu,
    /// The largest of a window of this side, so far apart; `up` says whether the last one may hang
    /// over the edge.
    Largest {
        side: usize,
        stride: usize,
        up: bool,
    },
    /// A blur that keeps every second pixel.
    Blurred,
    /// SqueezeNet's module: to `squeezed` channels, and from these to twice `expanded`, half by
    /// 1x1 and half by 3x3 kernels.
    Fire { squeezed: usize, expanded: usize },
}

impl Step {
    /// Channels after it, of so many before.
    pub fn outputs(self, inputs: usize) -> usize {
        match self {
            Self::Conv { outputs, .. } => outputs,
            Self::Fire { expanded, .. } => 2 * expanded,
            Self::Relu | Self::Largest { .. } | Self::Blurred => inputs,
        }
    }
}

/// An architecture that LPIPS is computed with.
pub struct Network {
    /// The name of its column in tables.
    pub name: &'static str,
    /// A tensor that no other network has.
    pub sign: &'static str,
    /// What happens in each slice.
    pub slices: fn() -> Vec<Vec<Step>>,
}

/// All that are known. The shift-tolerant ones blur wherever they halve, and halve by nothing else.
pub const NETWORKS: [Network; 5] = [
    Network {
        name: "lpips_alex",
        sign: "net.slice5.10.weight",
        slices: || alex(vec![conv(64, 11, 4, 2), Relu], &[largest(3, 2)]),
    },
    Network {
        name: "lpips_vgg",
        sign: "net.slice5.24.weight",
        slices: || vgg(&[largest(2, 2)]),
    },
    Network {
        name: "lpips_squeeze",
        sign: "net.slice7.12.squeeze.weight",
        slices: squeeze,
    },
    Network {
        name: "stlpips_alex",
        // Blurs count as steps in the package, so the numbers differ from plain AlexNet's.
        sign: "net.slice5.13.weight",
        slices: || {
            alex(
                vec![conv(64, 11, 1, 2), Blurred, Relu],
                &[largest(3, 1), Blurred],
            )
        },
    },
    Network {
        name: "stlpips_vgg",
        sign: "net.slice5.32.weight",
        slices: || vgg(&[largest(2, 1), Blurred]),
    },
];

/// AlexNet, which begins with `first` and makes images smaller by `halving`.
fn alex(first: Vec<Step>, halving: &[Step]) -> Vec<Vec<Step>> {
    vec![
        first,
        // The package compares right after a ReLU, so pooling opens the next slice.
        [halving, &[conv(192, 5, 1, 2), Relu]].concat(),
        [halving, &[conv(384, 3, 1, 1), Relu]].concat(),
        vec![conv(256, 3, 1, 1), Relu],
        vec![conv(256, 3, 1, 1), Relu],
    ]
}

/// The slices of torchvision's VGG-16.
fn vgg(halving: &[Step]) -> Vec<Vec<Step>> {
    let convs = |outputs, count| [conv(outputs, 3, 1, 1), Relu].repeat(count);
    vec![
        convs(64, 2),
        [halving, &convs(128, 2)].concat(),
        [halving, &convs(256, 3)].concat(),
        [halving, &convs(512, 3)].concat(),
        [halving, &convs(512, 3)].concat(),
    ]
}

/// The slices of torchvision's SqueezeNet 1.1.
fn squeeze() -> Vec<Vec<Step>> {
    // Torchvision pools with `ceil_mode` in SqueezeNet, and without it in the other trunks.
    let halving = Step::Largest {
        side: 3,
        stride: 2,
        up: true,
    };
    let fire = |squeezed| Step::Fire {
        squeezed,
        expanded: 4 * squeezed,
    };
    vec![
        vec![conv(64, 3, 2, 0), Relu],
        vec![halving, fire(16), fire(16)],
        vec![halving, fire(32), fire(32)],
        // The last four slices have one resolution: they are cut where the package cuts.
        vec![halving, fire(48)],
        vec![fire(48)],
        vec![fire(64)],
        vec![fire(64)],
    ]
}

fn conv(outputs: usize, side: usize, stride: usize, pad: usize) -> Step {
    Step::Conv {
        outputs,
        side,
        stride,
        pad,
    }
}

fn largest(side: usize, stride: usize) -> Step {
    Step::Largest {
        side,
        stride,
        up: false,
    }
}
