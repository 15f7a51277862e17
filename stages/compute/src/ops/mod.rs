//! The operators, one folder each: what it is, its shapes, checks and dispatch in `mod.rs`, its
//! kernels in `cpu.rs`, `gpu.rs` and `*.wgsl`. They know arrays and weights, not what those are
//! for.
//!
//! Imports go one way: dispatch to kernels, kernels to the extents that they share with it, and all
//! of them down to [`runtime`](crate::runtime). An operator that is a product, as convolution is,
//! imports the product's kernels.

pub mod adam;
pub mod attention;
pub mod conv;
pub mod elementwise;
pub mod norm;
pub mod product;
pub mod resize;
pub mod shape;
mod tuning;
