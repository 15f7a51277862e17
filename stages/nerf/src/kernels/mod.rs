//! The inner loops, for the CPU: small matrix products and the hash grid. They know shapes and
//! indices, and nothing of rays, losses or training; another device would bring its own versions of
//! these files only.
//!
//! They are compiled once per instruction set and chosen at run time by `pulp`; all but `wide` are
//! safe code. Sums run in the same order with the same fused multiply-adds whatever the vector
//! width, so results do not depend on the machine.

pub mod hash;
pub mod matrix;
pub mod slope;
#[cfg(target_arch = "x86_64")]
mod wide;
