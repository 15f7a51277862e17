//! The layers that the networks are built of. Each reads its weights by diffusers' names and knows
//! nothing of the network around it; those that LoRA training passes through have a backward pass
//! beside the forward one.

mod attention;
mod conv;
mod linear;
mod norm;
mod projection;
mod resample;
mod resnet;
mod transformer;

pub(crate) use conv::Conv2d;
pub(crate) use linear::Linear;
pub(crate) use norm::{GroupMoments, GroupNorm, LayerNorm};
pub(crate) use resample::{Downsample, Upsample};
pub(crate) use resnet::{Resnet, ResnetShape, ResnetTape};
pub(crate) use transformer::{Transformer, TransformerShape, TransformerTape};
