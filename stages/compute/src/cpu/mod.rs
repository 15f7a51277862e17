//! The kernels of the CPU back end: slices in, vectors out. They trust the shapes that the operators have checked.

pub mod activation;
pub mod adam;
pub mod attention;
pub mod conv;
mod gemm;
mod lanes;
pub mod linear;
pub mod map;
mod math;
pub mod norm;
pub mod resize;
pub mod shape;
mod simd;
pub mod weight;
