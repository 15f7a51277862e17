//! What GPU kernels share. They take device buffers, give device buffers, and trust the shapes that
//! operators have checked.
//!
//! A kernel is WGSL expanded from templates (`*.wgsl`) for a class of shapes and compiled once.
//! Commands are recorded and handed over in batches, in their order; values come back only where an
//! operator gives a number to the host. Every sum has a fixed order and no kernel of this crate
//! uses atomics: the same adapter and driver give the same bits. Other crates bring kernels of
//! their own ([`crate::kernels`]).

pub mod adapter;
pub mod context;
pub mod counts;
pub mod each;
pub mod error;
pub mod factor;
pub mod fault;
pub mod job;
pub mod kernel;
pub mod launch;
pub mod memory;
pub mod params;
mod pipeline;
pub mod pool;
mod quiet;
mod recorder;
mod split;
mod template;
pub mod tile;
pub mod tuning;
