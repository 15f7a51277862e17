//! The innermost loops: transforms of as many tiles, or kernels, at a time as a vector has lanes,
//! and the products at one spot. They know where numbers lie, not which part of an image they are.
//!
//! Shapes: P tiles of a panel, R outputs of a block, S spots of a tile (`extents.rs`), C channels.

mod inputs;
mod multiply;
mod outputs;
mod taps;

pub use inputs::{Lines, TransformInputs};
pub use multiply::Multiply;
pub use outputs::TransformOutputs;
pub use taps::TransformTaps;
