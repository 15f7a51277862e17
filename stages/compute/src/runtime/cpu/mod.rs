//! What CPU kernels share: memory, vectors, chunks of work and views of matrices. They take slices,
//! give buffers, and trust the shapes that operators have checked.

pub mod buffer;
pub mod chunks;
pub mod lanes;
pub mod math;
pub mod matrix;
pub mod share;
pub mod simd;
pub mod transpose;
pub mod values;
pub mod vector;
