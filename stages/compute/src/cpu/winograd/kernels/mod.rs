//! The innermost loops: transforms of as many tiles, or kernels, at a time as a vector has lanes,
//! and the products at one spot. They know where numbers lie, not which part of an image they are.
//!
//! Shapes: P = [`COLUMNS`] tiles of a panel, R = [`BLOCK`] outputs of a block, S = 36 spots of a
//! tile, C channels.

mod inputs;
mod multiply;
mod outputs;
mod taps;

use super::transform::{SIDE, SIGHT};
pub use crate::cpu::tile::COLUMNS;
pub use inputs::{Lines, TransformInputs};
pub use multiply::Multiply;
pub use outputs::TransformOutputs;
pub use taps::TransformTaps;

/// Outputs whose kernels are packed side by side: a cache line of them.
pub const BLOCK: usize = 16;
/// The most lanes of a vector.
pub const WIDEST: usize = 16;
/// Pixels of a line that the tiles of a panel see.
pub const SEEN: usize = SIDE * COLUMNS + SIGHT - SIDE;
/// Terms after which the total joins what the result holds. With the length of a chain (`multiply`)
/// it decides the order of a sum, and so its bits.
pub const DEPTH: usize = 128;
