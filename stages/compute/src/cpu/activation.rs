//! Nonlinearities and their slopes.

use super::map::{fill, map, zip};
use super::math::{normal_cdf, normal_density, sigmoid};
use super::simd::vectorize;
use crate::activation::Function;

/// Tokens per task of the gated activation.
const ROWS: usize = 16;

#[inline(always)]
pub fn silu(x: f32) -> f32 {
    x * sigmoid(x)
}

#[inline(always)]
pub fn silu_slope(x: f32) -> f32 {
    let s = sigmoid(x);
    s * (1.0 + x * (1.0 - s))
}

#[inline(always)]
fn gelu_slope(x: f32) -> f32 {
    normal_cdf(x) + x * normal_density(x)
}

/// CLIP's constant.
const QUICK: f32 = 1.702;

#[inline(always)]
fn quick_gelu_slope(x: f32) -> f32 {
    let s = sigmoid(QUICK * x);
    s * (1.0 + QUICK * x * (1.0 - s))
}

pub fn apply(function: Function, x: &[f32]) -> Vec<f32> {
    match function {
        Function::Silu => map(x, silu),
        Function::Gelu => map(
            x,
            #[inline(always)]
            |x| x * normal_cdf(x),
        ),
        Function::QuickGelu => map(
            x,
            #[inline(always)]
            |x| x * sigmoid(QUICK * x),
        ),
    }
}

pub fn backward(function: Function, x: &[f32], dy: &[f32]) -> Vec<f32> {
    match function {
        Function::Silu => zip(
            x,
            dy,
            #[inline(always)]
            |x, dy| dy * silu_slope(x),
        ),
        Function::Gelu => zip(
            x,
            dy,
            #[inline(always)]
            |x, dy| dy * gelu_slope(x),
        ),
        Function::QuickGelu => zip(
            x,
            dy,
            #[inline(always)]
            |x, dy| dy * quick_gelu_slope(x),
        ),
    }
}

/// `a gelu(b)` for rows `[a, b]` of `2 * half` elements.
pub fn geglu(x: &[f32], half: usize) -> Vec<f32> {
    let mut out = vec![0.0; x.len() / 2];
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

pub fn geglu_backward(x: &[f32], dy: &[f32], half: usize) -> Vec<f32> {
    let mut dx = vec![0.0; x.len()];
    fill(&mut dx, 2 * ROWS * half.max(1), |i, dx| {
        let rows = x[i * 2 * ROWS * half..].chunks(2 * half).zip(dy[i * ROWS * half..].chunks(half));
        for (dx, (x, dy)) in dx.chunks_mut(2 * half).zip(rows) {
            let ((a, b), (da, db)) = (x.split_at(half), dx.split_at_mut(half));
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
