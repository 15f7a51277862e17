//! The kernels of the CPU back end: slices in, vectors out. They trust the shapes that the operators have checked.

pub mod activation;
pub mod adam;
pub mod attention;
pub mod buffer;
pub mod conv;
mod lanes;
pub mod linear;
pub mod map;
mod math;
mod matrix;
pub mod norm;
mod product;
pub mod resize;
pub mod shape;
mod simd;
mod tile;
mod transpose;
mod vector;
pub mod weight;
mod winograd;
