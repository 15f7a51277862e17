//! The kernels of the CPU back end: slices in, buffers out. They trust the shapes that the
//! operators have checked.

pub mod activation;
pub mod adam;
pub mod attention;
mod bf16;
pub mod buffer;
pub mod conv;
mod factor;
mod lanes;
pub mod linear;
pub mod map;
mod math;
mod matrix;
pub mod norm;
mod product;
pub mod resize;
pub mod shape;
pub mod simd;
mod tile;
mod transpose;
mod vector;
pub mod weight;
pub mod winograd;
