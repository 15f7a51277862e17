//! The operators' tests in one program, which runs itself again at every other level of vector
//! instructions.

mod common;
mod golden;
mod gradients;
mod levels;
mod memory;
mod ops;
mod precision;
mod threads;
mod weights;
mod winograd;
