//! Element-by-element loops and reductions, cut into chunks of fixed size.

use rayon::prelude::*;

use super::function::{Binary, Reduction, Unary};
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::chunks::{CHUNK, fill};
use crate::runtime::cpu::math::{
    QUICK, gelu_slope, normal_cdf, quick_gelu_slope, sigmoid, silu, silu_slope,
};
use crate::runtime::cpu::simd::vectorize;

/// Tokens per task of the gated activation.
const ROWS: usize = 16;

/// Maps a closure over chunks. A macro, so that the closure is surely inlined where its vectors may
/// be used.
macro_rules! map {
    ($x:expr, |$a:ident| $value:expr) => {{
        let x: &[f32] = $x;
        let mut out = HostBuffer::uninitialised(x.len());
        fill(&mut out, CHUNK, |i, out| {
            let x = &x[i * CHUNK..];
            vectorize(
                #[inline(always)]
                || {
                    for (out, &$a) in out.iter_mut().zip(x) {
                        *out = $value;
                    }
                },
            )
        });
        out
    }};
}

macro_rules! zip {
    ($x:expr, $y:expr, |$a:ident, $b:ident| $value:expr) => {{
        let x: &[f32] = $x;
        let y: &[f32] = $y;
        let mut out = HostBuffer::uninitialised(x.len());
        fill(&mut out, CHUNK, |i, out| {
            let x = &x[i * CHUNK..];
            let y = &y[i * CHUNK..];
            vectorize(
                #[inline(always)]
                || {
                    for ((out, &$a), &$b) in out.iter_mut().zip(x).zip(y) {
                        *out = $value;
                    }
                },
            )
        });
        out
    }};
}

/// A function of every element.
pub fn unary(function: Unary, x: &[f32]) -> HostBuffer {
    match function {
        Unary::Scale(factor) => map!(x, |x| factor * x),
        Unary::Clamp { low, high } => map!(x, |x| x.clamp(low, high)),
        Unary::Offset(number) => map!(x, |x| x + number),
        Unary::Leaky(slope) => map!(x, |x| if x > 0.0 { x } else { slope * x }),
        Unary::Sigmoid => map!(x, |x| sigmoid(x)),
        // Not `signum`, which gives 1 for 0.
        Unary::Sign => map!(x, |x| (x > 0.0) as i32 as f32 - (x < 0.0) as i32 as f32),
        Unary::Silu => map!(x, |x| silu(x)),
        Unary::Gelu => map!(x, |x| x * normal_cdf(x)),
        Unary::QuickGelu => map!(x, |x| x * sigmoid(QUICK * x)),
    }
}

/// A function of every pair of elements.
pub fn binary(function: Binary, x: &[f32], y: &[f32]) -> HostBuffer {
    match function {
        Binary::Product => zip!(x, y, |x, y| x * y),
        Binary::Sum([a, b]) => zip!(x, y, |x, y| a * x + b * y),
        Binary::SiluSlope => zip!(x, y, |x, dy| dy * silu_slope(x)),
        Binary::GeluSlope => zip!(x, y, |x, dy| dy * gelu_slope(x)),
        Binary::QuickGeluSlope => zip!(x, y, |x, dy| dy * quick_gelu_slope(x)),
    }
}

/// A number from all elements: chunk by chunk, then over the chunks in their order.
pub fn reduce(reduction: Reduction, x: &[f32]) -> f64 {
    match reduction {
        // In f64, since a long sum in f32 loses the last digits of what it adds.
        Reduction::Sum => fold(x, f64::from, |a, b| a + b),
        Reduction::SumOfSquares => fold(x, |x| f64::from(x) * f64::from(x), |a, b| a + b),
        // `f64::max` passes over NaN.
        Reduction::MaxAbs => fold(x, |x| f64::from(x.abs()), f64::max),
    }
}

/// Every plane of `plane` elements plus its own number.
pub fn add_per_plane(x: &[f32], numbers: &[f32], plane: usize) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(x.len());
    // A plane is one task, so its number is read once.
    fill(&mut out, plane.max(1), |i, out| {
        let x = &x[i * plane..];
        vectorize(
            #[inline(always)]
            || {
                for (out, x) in out.iter_mut().zip(x) {
                    *out = x + numbers[i];
                }
            },
        )
    });
    out
}

/// Every plane of `plane` elements, where they are below 0 times the number of its channel.
pub fn leaky_per_channel(x: &[f32], slopes: &[f32], plane: usize) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(x.len());
    fill(&mut out, plane.max(1), |i, out| {
        let x = &x[i * plane..];
        let slope = slopes[i % slopes.len()];
        vectorize(
            #[inline(always)]
            || {
                for (out, &x) in out.iter_mut().zip(x) {
                    *out = if x > 0.0 { x } else { slope * x };
                }
            },
        )
    });
    out
}

/// `a gelu(b)` for rows `[a, b]` of `2 * half` elements.
pub fn geglu(x: &[f32], half: usize) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(x.len() / 2);
    fill(&mut out, ROWS * half.max(1), |i, out| {
        let x = &x[i * 2 * ROWS * half..];
        for (out, x) in out.chunks_mut(half).zip(x.chunks(2 * half)) {
            let (a, b) = x.split_at(half);
            vectorize(
                #[inline(always)]
                || {
                    for ((out, a), &b) in out.iter_mut().zip(a).zip(b) {
                        *out = a * b * normal_cdf(b);
                    }
                },
            );
        }
    });
    out
}

/// The gradient of [`geglu`].
pub fn geglu_backward(x: &[f32], dy: &[f32], half: usize) -> HostBuffer {
    let mut dx = HostBuffer::uninitialised(x.len());
    fill(&mut dx, 2 * ROWS * half.max(1), |i, dx| {
        let rows = x[i * 2 * ROWS * half..]
            .chunks(2 * half)
            .zip(dy[i * ROWS * half..].chunks(half));
        for (dx, (x, dy)) in dx.chunks_mut(2 * half).zip(rows) {
            let (a, b) = x.split_at(half);
            let (da, db) = dx.split_at_mut(half);
            vectorize(
                #[inline(always)]
                || {
                    for ((((da, db), a), &b), dy) in da.iter_mut().zip(db).zip(a).zip(b).zip(dy) {
                        *da = dy * b * normal_cdf(b);
                        *db = dy * a * gelu_slope(b);
                    }
                },
            );
        }
    });
    dx
}

/// Folds `term` of every element, starting from 0.
fn fold(x: &[f32], term: impl Fn(f32) -> f64 + Sync, join: impl Fn(f64, f64) -> f64 + Sync) -> f64 {
    let partial: Vec<f64> = x
        .par_chunks(CHUNK)
        .map(|x| x.iter().fold(0.0, |sum, &x| join(sum, term(x))))
        .collect();
    // One order for any number of threads.
    partial.into_iter().fold(0.0, join)
}
