//! Element-by-element loops and reductions, cut into chunks of fixed size.

use rayon::prelude::*;

use super::simd::vectorize;

/// Elements per task: large enough to hide the cost of a task, small enough to stay in the first cache.
pub const CHUNK: usize = 1 << 14;

/// Calls `kernel` with the number and the values of every chunk of `out`.
pub fn fill(out: &mut [f32], chunk: usize, kernel: impl Fn(usize, &mut [f32]) + Sync) {
    if out.len() <= chunk {
        kernel(0, out);
    } else {
        out.par_chunks_mut(chunk).enumerate().for_each(|(i, out)| kernel(i, out));
    }
}

/// `f` of every element.
pub fn map(x: &[f32], f: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    let mut out = vec![0.0; x.len()];
    fill(&mut out, CHUNK, |i, out| {
        let x = &x[i * CHUNK..];
        vectorize(
            #[inline(always)]
            || {
                for (out, &x) in out.iter_mut().zip(x) {
                    *out = f(x);
                }
            },
        )
    });
    out
}

/// `f` of every pair of elements.
pub fn zip(x: &[f32], y: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let mut out = vec![0.0; x.len()];
    fill(&mut out, CHUNK, |i, out| {
        let (x, y) = (&x[i * CHUNK..], &y[i * CHUNK..]);
        vectorize(
            #[inline(always)]
            || {
                for ((out, &x), &y) in out.iter_mut().zip(x).zip(y) {
                    *out = f(x, y);
                }
            },
        )
    });
    out
}

/// The sum of `factor * values` over the terms, from left to right.
pub fn scaled_sum(terms: &[(f32, &[f32])]) -> Vec<f32> {
    match *terms {
        [] => Vec::new(),
        [(a, x)] => map(x, |x| a * x),
        [(a, x), (b, y)] => zip(x, y, |x, y| a * x + b * y),
        [ref first @ .., (a, x)] => zip(&scaled_sum(first), x, |sum, x| sum + a * x),
    }
}

/// Every plane of `plane` elements plus its own number.
pub fn add_per_plane(x: &[f32], numbers: &[f32], plane: usize) -> Vec<f32> {
    let mut out = x.to_vec();
    fill(&mut out, plane.max(1), |i, out| out.iter_mut().for_each(|out| *out += numbers[i]));
    out
}

/// Folds `term` of every element, starting from 0: chunk by chunk, then over the chunks in their order.
pub fn fold(x: &[f32], term: impl Fn(f32) -> f64 + Sync, join: impl Fn(f64, f64) -> f64 + Sync) -> f64 {
    let partial: Vec<f64> = x.par_chunks(CHUNK).map(|x| x.iter().fold(0.0, |sum, &x| join(sum, term(x)))).collect();
    partial.into_iter().fold(0.0, join)
}
