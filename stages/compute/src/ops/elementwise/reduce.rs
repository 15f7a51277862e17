//! Whole-array reductions to one number: in a fixed order, with `f64` accumulators.

use super::function::Reduction;
use super::{cpu, gpu};
use crate::runtime::array::Array;
use crate::runtime::device::Backend;

fn reduce(reduction: Reduction, x: &Array) -> f64 {
    match x.device().backend() {
        Backend::Cpu => cpu::reduce(reduction, x.host()),
        Backend::Gpu(gpu) => gpu::reduce(gpu, reduction, x.device_buffer(), x.len()),
    }
}

/// The sum of all elements; 0 for an empty array.
pub fn sum(x: &Array) -> f32 {
    reduce(Reduction::Sum, x) as f32
}

/// The mean of all elements; NaN for an empty array.
pub fn mean(x: &Array) -> f32 {
    (reduce(Reduction::Sum, x) / x.len() as f64) as f32
}

/// The mean of the squares of all elements; NaN for an empty array.
pub fn mean_square(x: &Array) -> f32 {
    (reduce(Reduction::SumOfSquares, x) / x.len() as f64) as f32
}

/// The largest magnitude; 0 for an empty array. NaN elements are passed over.
pub fn max_abs(x: &Array) -> f32 {
    reduce(Reduction::MaxAbs, x) as f32
}
