//! The inner loops, for the CPU: small matrix products and the hash grid. They know shapes and indices, and nothing of
//! rays, losses or training; another device would bring its own versions of these files only.
//!
//! All are safe code that `pulp` compiles once per instruction set and chooses at run time. Sums run in the same order
//! with the same fused multiply-adds whatever the vector width, so results do not depend on the machine.

pub mod hash;
pub mod matrix;
