//! The kernels of the GPU back end: device buffers in, device buffers out. They trust the shapes
//! that the operators have checked.
//!
//! A kernel is WGSL expanded from a template (`wgsl/*.wgsl`) for a class of shapes and compiled
//! once. Commands are recorded and handed over in batches, in their order; values come back only
//! where an operator gives a number to the host. Every sum has a fixed order and no kernel here
//! uses atomics: the same adapter and driver give the same bits. Other crates bring kernels of
//! their own ([`crate::kernels`]).

pub mod adapter;
pub mod attention;
pub mod context;
pub mod conv;
pub mod counts;
pub mod error;
pub mod fault;
pub mod kernel;
pub mod launch;
pub mod linear;
pub mod map;
pub mod norm;
pub mod pool;
pub mod product;
mod recorder;
pub mod resize;
pub mod shape;
mod split;
mod template;
pub mod tuning;
