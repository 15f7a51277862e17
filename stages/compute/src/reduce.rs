//! Whole-array reductions to one number: in a fixed order, with `f64` accumulators.

use crate::array::Array;
use crate::cpu;
use crate::device::Backend;

fn total(x: &Array, term: impl Fn(f32) -> f64 + Sync) -> f64 {
    match x.device().backend() {
        Backend::Cpu => cpu::map::fold(x.host(), term, |a, b| a + b),
    }
}

/// The sum of all elements; 0 for an empty array.
pub fn sum(x: &Array) -> f32 {
    total(x, f64::from) as f32
}

/// The mean of all elements; NaN for an empty array.
pub fn mean(x: &Array) -> f32 {
    (total(x, f64::from) / x.len() as f64) as f32
}

/// The mean of the squares of all elements; NaN for an empty array.
pub fn mean_square(x: &Array) -> f32 {
    (total(x, |x| f64::from(x) * f64::from(x)) / x.len() as f64) as f32
}

/// The largest magnitude; 0 for an empty array. NaN elements are passed over.
pub fn max_abs(x: &Array) -> f32 {
    match x.device().backend() {
        Backend::Cpu => cpu::map::fold(x.host(), |x| f64::from(x.abs()), f64::max) as f32,
    }
}
