//! One step of the walk through the UNet: a layer, or a move on the stack of skip connections.

use compute::Array;
use compute::elementwise::add;
use compute::shape::{concat, slice};

use super::{Input, TextContext, accumulate};
use crate::layers::{Downsample, Resnet, ResnetTape, Transformer, TransformerTape, Upsample};
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};

/// A step of the walk.
pub(super) enum Layer {
    Resnet(Box<Resnet>),
    Transformer(Box<Transformer>),
    Downsample(Downsample),
    /// Doubles to the size of the skip connection on top of the stack.
    Upsample(Upsample),
    /// Puts the image on the stack.
    Push,
    /// Takes an image from the stack and joins it to this one along the channels.
    Pop,
}

/// What a step's backward pass needs.
pub(super) enum LayerTape {
    Resnet(ResnetTape),
    Transformer(TransformerTape),
    /// Height and width of the input.
    Resize([usize; 2]),
    Push,
    /// Channels of the image before joining.
    Pop(usize),
    /// The input of a layer, to compute its tape from once more.
    Again(Array),
}

/// Where the walk stands: the image (or, backwards, its gradient) and the open skip connections.
#[derive(Clone)]
pub(super) struct WalkState {
    pub x: Array,
    pub skips: Vec<Array>,
}

/// What does not change along the walk.
pub(super) struct Pass<'a> {
    /// The time embedding after its activation `[N, D]`.
    pub time: &'a Array,
    pub text: &'a TextContext,
    pub lora: Option<&'a LoraNetwork>,
}

impl<'a> Pass<'a> {
    pub fn new(time: &'a Array, text: &'a TextContext, input: &Input<'a>) -> Self {
        Self {
            time,
            text,
            lora: input.lora,
        }
    }
}

/// What the walk back gathers.
pub(super) struct Gathered {
    pub lora: LoraGradients,
    /// The gradient by the time embedding, if there is something to learn behind it.
    pub time: Option<Array>,
}

impl LayerTape {
    /// The bytes that it holds beside the layer's input.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Resnet(tape) => tape.bytes(),
            Self::Transformer(tape) => tape.bytes(),
            Self::Resize(_) | Self::Push | Self::Pop(_) | Self::Again(_) => 0,
        }
    }

    /// Keeps the input only.
    pub fn reduce(&mut self) {
        match self {
            Self::Resnet(tape) => *self = Self::Again(tape.input().clone()),
            Self::Transformer(tape) => *self = Self::Again(tape.input().clone()),
            Self::Resize(_) | Self::Push | Self::Pop(_) | Self::Again(_) => {}
        }
    }
}

impl Layer {
    pub fn sites(&self) -> Vec<&AdapterSite> {
        match self {
            Self::Transformer(transformer) => transformer.sites().collect(),
            _ => Vec::new(),
        }
    }

    pub fn forward(&self, walk: &mut WalkState, pass: &Pass) -> LayerTape {
        let x = &walk.x;
        let size = [x.shape()[2], x.shape()[3]];
        let (y, tape) = match self {
            Self::Resnet(resnet) => {
                let (y, tape) = resnet.forward(x, Some(pass.time));
                (y, LayerTape::Resnet(tape))
            }
            Self::Transformer(transformer) => {
                let (y, tape) = transformer.forward(x, pass.text, pass.lora);
                (y, LayerTape::Transformer(tape))
            }
            Self::Downsample(downsample) => (downsample.forward(x), LayerTape::Resize(size)),
            Self::Upsample(upsample) => {
                // Where a side was odd, halving rounded up: the skip says which size is wanted.
                let to = walk
                    .skips
                    .last()
                    .map_or(size, |skip| [skip.shape()[2], skip.shape()[3]]);
                (upsample.forward(x, to), LayerTape::Resize(size))
            }
            Self::Push => {
                walk.skips.push(x.clone());
                return LayerTape::Push;
            }
            Self::Pop => {
                // Backwards the joined gradient is cut here again: [N, C + skip, H, W].
                let tape = LayerTape::Pop(x.shape()[1]);
                // The plan puts on the stack what it takes off, so there is always one.
                let skip = walk.skips.pop();
                (
                    skip.map_or_else(|| x.clone(), |skip| concat(&[x, &skip], 1)),
                    tape,
                )
            }
        };
        walk.x = y;
        tape
    }

    /// Moves the gradient in `walk` from the step's output to its input, if `input` asks for it.
    /// Backwards, joining puts a gradient on the stack and putting takes it off.
    pub fn backward(
        &self,
        tape: LayerTape,
        walk: &mut WalkState,
        pass: &Pass,
        gathered: &mut Gathered,
        input: bool,
    ) {
        let dy = &walk.x;
        let dx = match (self, tape) {
            // Only layers that look at no skip are reduced to their input, so an empty stack will
            // do.
            (_, LayerTape::Again(x)) => {
                let tape = self.forward(
                    &mut WalkState {
                        x,
                        skips: Vec::new(),
                    },
                    pass,
                );
                // The same operators on the same input give the same bits, so the gradient does not
                // depend on what was kept.
                return self.backward(tape, walk, pass, gathered, input);
            }
            (Self::Resnet(resnet), LayerTape::Resnet(tape)) => {
                let backward = resnet.backward(&tape, dy, input, gathered.time.is_some());
                accumulate(&mut gathered.time, backward.time);
                backward.x
            }
            (Self::Transformer(layer), LayerTape::Transformer(tape)) => {
                layer.backward(tape, dy, pass.lora, &mut gathered.lora, input)
            }
            (Self::Downsample(downsample), LayerTape::Resize(size)) => {
                Some(downsample.backward(dy, size))
            }
            (Self::Upsample(upsample), LayerTape::Resize(size)) => {
                Some(upsample.backward(dy, size))
            }
            // The image went two ways, on through the layers and onto the stack: both gradients add
            // up.
            (Self::Push, LayerTape::Push) => walk.skips.pop().map(|skip| add(dy, &skip)),
            (Self::Pop, LayerTape::Pop(channels)) => {
                walk.skips
                    .push(slice(dy, 1, channels, dy.shape()[1] - channels));
                Some(slice(dy, 1, 0, channels))
            }
            _ => unreachable!("a tape belongs to the layer that made it"),
        };
        if let Some(dx) = dx {
            walk.x = dx;
        }
    }
}
