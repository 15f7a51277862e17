//! Nonlinearities and their slopes, of single numbers; and the gated one, of tokens.

use super::buffer::Buffer;
use super::map::fill;
use super::math::{normal_cdf, normal_density, sigmoid};
use super::simd::vectorize;

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
pub fn gelu_slope(x: f32) -> f32 {
    normal_cdf(x) + x * normal_density(x)
}

/// CLIP's constant.
pub const QUICK: f32 = 1.702;

#[inline(always)]
pub fn quick_gelu_slope(x: f32) -> f32 {
    let s = sigmoid(QUICK * x);
    s * (1.0 + QUICK * x * (1.0 - s))
}

/// `a gelu(b)` for rows `[a, b]` of `2 * half` elements.
pub fn geglu(x: &[f32], half: usize) -> Buffer {
    let mut out = Buffer::stale(x.len() / 2);
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

pub fn geglu_backward(x: &[f32], dy: &[f32], half: usize) -> Buffer {
    let mut dx = Buffer::stale(x.len());
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
