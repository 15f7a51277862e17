//! Element-by-element loops and reductions, cut into chunks of fixed size.

use rayon::prelude::*;

use super::activation::{QUICK, gelu_slope, quick_gelu_slope, silu, silu_slope};
use super::buffer::Buffer;
use super::math::{normal_cdf, sigmoid};
use super::simd::vectorize;
use crate::conv::Finish;
use crate::function::{Binary, Reduction, Unary};

/// Elements per task: large enough to hide the cost of a task, small enough to stay in the first
/// cache.
pub const CHUNK: usize = 1 << 14;

/// Elements that one thread works through sooner than it wakes others.
const ALONE: usize = 2 * CHUNK;

/// Calls `kernel` with the number and the values of every chunk of `out`.
pub fn fill(out: &mut [f32], chunk: usize, kernel: impl Fn(usize, &mut [f32]) + Sync) {
    if out.len() <= chunk.max(ALONE) {
        out.chunks_mut(chunk)
            .enumerate()
            .for_each(|(i, out)| kernel(i, out));
    } else {
        out.par_chunks_mut(chunk)
            .enumerate()
            .for_each(|(i, out)| kernel(i, out));
    }
}

/// Maps a closure over chunks. A macro, so that the closure is surely inlined where its vectors may
/// be used.
macro_rules! map {
    ($x:expr, |$a:ident| $value:expr) => {{
        let x: &[f32] = $x;
        let mut out = Buffer::stale(x.len());
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
        let mut out = Buffer::stale(x.len());
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
pub fn unary(function: Unary, x: &[f32]) -> Buffer {
    match function {
        Unary::Scale(factor) => map!(x, |x| factor * x),
        Unary::Clamp { low, high } => map!(x, |x| x.clamp(low, high)),
        Unary::Offset(number) => map!(x, |x| x + number),
        Unary::Leaky(slope) => map!(x, |x| if x > 0.0 { x } else { slope * x }),
        Unary::Sigmoid => map!(x, |x| sigmoid(x)),
        Unary::Sign => map!(x, |x| (x > 0.0) as i32 as f32 - (x < 0.0) as i32 as f32),
        Unary::Silu => map!(x, |x| silu(x)),
        Unary::Gelu => map!(x, |x| x * normal_cdf(x)),
        Unary::QuickGelu => map!(x, |x| x * sigmoid(QUICK * x)),
    }
}

/// A function of every pair of elements.
pub fn binary(function: Binary, x: &[f32], y: &[f32]) -> Buffer {
    match function {
        Binary::Product => zip!(x, y, |x, y| x * y),
        Binary::Sum([a, b]) => zip!(x, y, |x, y| a * x + b * y),
        Binary::SiluSlope => zip!(x, y, |x, dy| dy * silu_slope(x)),
        Binary::GeluSlope => zip!(x, y, |x, dy| dy * gelu_slope(x)),
        Binary::QuickGeluSlope => zip!(x, y, |x, dy| dy * quick_gelu_slope(x)),
    }
}

/// Finishes what a convolution gave, in place.
pub fn finish(x: &mut [f32], finish: Finish<&[f32]>) {
    if finish == Finish::None {
        return;
    }
    fill(x, CHUNK, |i, x| {
        vectorize(
            #[inline(always)]
            || match finish {
                Finish::None => (),
                Finish::Leaky(slope) => {
                    for x in x {
                        *x = if *x > 0.0 { *x } else { slope * *x };
                    }
                }
                Finish::Add(other) => {
                    for (x, other) in x.iter_mut().zip(&other[i * CHUNK..]) {
                        *x += other;
                    }
                }
            },
        );
    });
}

/// A number from all elements: chunk by chunk, then over the chunks in their order.
pub fn reduce(reduction: Reduction, x: &[f32]) -> f64 {
    match reduction {
        Reduction::Sum => fold(x, f64::from, |a, b| a + b),
        Reduction::SumOfSquares => fold(x, |x| f64::from(x) * f64::from(x), |a, b| a + b),
        Reduction::MaxAbs => fold(x, |x| f64::from(x.abs()), f64::max),
    }
}

/// Every plane of `plane` elements plus its own number.
pub fn add_per_plane(x: &[f32], numbers: &[f32], plane: usize) -> Buffer {
    let mut out = Buffer::stale(x.len());
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
pub fn leaky_per_channel(x: &[f32], slopes: &[f32], plane: usize) -> Buffer {
    let mut out = Buffer::stale(x.len());
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

/// Folds `term` of every element, starting from 0.
fn fold(x: &[f32], term: impl Fn(f32) -> f64 + Sync, join: impl Fn(f64, f64) -> f64 + Sync) -> f64 {
    let partial: Vec<f64> = x
        .par_chunks(CHUNK)
        .map(|x| x.iter().fold(0.0, |sum, &x| join(sum, term(x))))
        .collect();
    partial.into_iter().fold(0.0, join)
}
