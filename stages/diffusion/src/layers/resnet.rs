//! `ResnetBlock2D` of diffusers: two normalised convolutions beside a shortcut, told the time in
//! between.

use compute::Array;
use compute::elementwise::{add, add_channels};
use compute::linear::linear;
use compute::norm::Activation;

use super::conv::size;
use super::{Conv2d, GroupNorm, Linear};
use crate::error::ModelError;
use crate::weights::Scope;

/// The sizes of one block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ResnetShape {
    pub inputs: usize,
    pub outputs: usize,
    /// Width of the time embedding; `None` for a block that knows no time.
    pub time: Option<usize>,
    pub groups: usize,
    pub eps: f32,
}

/// A residual block: two normalised 3x3 convolutions, with the time embedding added between them.
pub(crate) struct Resnet {
    norm1: GroupNorm,
    conv1: Conv2d,
    time: Option<Linear>,
    norm2: GroupNorm,
    conv2: Conv2d,
    shortcut: Option<Conv2d>,
}

/// What the backward pass needs: the inputs of the two normalisations.
pub(crate) struct ResnetTape {
    x: Array,
    hidden: Array,
}

/// The gradients that a block passes on, each if it was asked for.
pub(crate) struct ResnetGradients {
    pub x: Option<Array>,
    pub time: Option<Array>,
}

impl ResnetTape {
    /// The input `[N, C, H, W]`, from which the tape can be computed once more.
    pub fn input(&self) -> &Array {
        &self.x
    }

    /// The bytes that it holds beside the input.
    pub fn bytes(&self) -> usize {
        4 * self.hidden.len()
    }
}

impl Resnet {
    pub fn read(scope: &Scope, shape: &ResnetShape) -> Result<Self, ModelError> {
        let inputs = shape.inputs;
        let outputs = shape.outputs;
        let norm = |name, channels| {
            GroupNorm::read(
                &scope.at(name),
                channels,
                shape.groups,
                shape.eps,
                Activation::Silu,
            )
        };
        let time = shape
            .time
            .map(|width| Linear::read(&scope.at("time_emb_proj"), width, outputs))
            .transpose()?;
        // Diffusers has this convolution in just those blocks that change the number of channels.
        let shortcut = (inputs != outputs)
            .then(|| Conv2d::pointwise(&scope.at("conv_shortcut"), inputs, outputs));
        Ok(Self {
            norm1: norm("norm1", inputs)?,
            conv1: Conv2d::read(&scope.at("conv1"), inputs, outputs)?,
            time,
            norm2: norm("norm2", outputs)?,
            conv2: Conv2d::read(&scope.at("conv2"), outputs, outputs)?,
            shortcut: shortcut.transpose()?,
        })
    }

    /// `x [N, C, H, W]`; `time [N, D]` is the time embedding after its activation.
    pub fn forward(&self, x: &Array, time: Option<&Array>) -> (Array, ResnetTape) {
        self.forward_by(x, time, |norm, x| norm.forward(x))
    }

    /// [`Resnet::forward`] with normalisations that the caller computes.
    pub fn forward_by(
        &self,
        x: &Array,
        time: Option<&Array>,
        mut normalise: impl FnMut(&GroupNorm, &Array) -> Array,
    ) -> (Array, ResnetTape) {
        // [N, C', H, W]; norm1 and norm2 hold the SiLU that comes before each convolution.
        let mut hidden = self.conv1.forward(&normalise(&self.norm1, x));
        if let (Some(layer), Some(time)) = (&self.time, time) {
            hidden = add_channels(&hidden, &layer.forward(time));
        }
        let y = self.conv2.forward(&normalise(&self.norm2, &hidden));
        let y = match &self.shortcut {
            Some(shortcut) => add(&shortcut.forward(x), &y),
            None => add(x, &y),
        };
        (
            y,
            ResnetTape {
                x: x.clone(),
                hidden,
            },
        )
    }

    /// The gradients by `x` and by `time`, each if its flag asks for it.
    pub fn backward(
        &self,
        tape: &ResnetTape,
        dy: &Array,
        input: bool,
        time: bool,
    ) -> ResnetGradients {
        let size = size(dy);
        let hidden = self
            .norm2
            .backward(&tape.hidden, &self.conv2.backward(dy, size));
        let time = self
            .time
            .as_ref()
            .filter(|_| time)
            // `hidden` is the sum of conv1's result and the time's, so its gradient is that of
            // both.
            .map(|layer| layer.backward(&sum_pixels(&hidden)));
        let x = input.then(|| {
            let x = self
                .norm1
                .backward(&tape.x, &self.conv1.backward(&hidden, size));
            match &self.shortcut {
                Some(shortcut) => add(&shortcut.backward(dy, size), &x),
                None => add(dy, &x),
            }
        });
        ResnetGradients { x, time }
    }
}

/// The gradient of adding `[N, C]` to every pixel: `[N, C, H, W]` summed over pixels.
fn sum_pixels(d: &Array) -> Array {
    let n = d.shape()[0];
    let c = d.shape()[1];
    let pixels = d.len() / (n * c);
    // A product with ones, since no operator sums over pixels.
    let ones = d.device().full(&[1, pixels], 1.0);
    linear(&d.reshape(&[n * c, pixels]), &ones, None).reshape(&[n, c])
}
