//! Winograd's minimal filtering F(4x4, 3x3) along one axis: the transforms of inputs, kernels and
//! outputs. Lavin and Gray 2015, section 4.3, with the points 0, ±3/4, ±3/2 and infinity, whose
//! transforms B^T, G and A^T lose half as many bits as theirs: some five times the rounding error
//! of plain summation, about 2e-6 of the norm.
//!
//! It knows no second axis, no images and no channels. SAFETY of every function: that of [`Quads`].
#![allow(unsafe_code)]

use super::extents::{SIDE, SIGHT};
use super::quads::Quads;

/// The two positive points, A and B, and their powers.
const A: f32 = 0.75;
const B: f32 = 1.5;
const AA: f32 = A * A;
const BB: f32 = B * B;

/// B^T of six numbers.
#[inline(always)]
pub unsafe fn input_transform<V: Quads>(d: [V; SIGHT]) -> [V; SIGHT] {
    // SAFETY: by the contract of this module.
    unsafe {
        let even_a = d[4].minus(d[2].times(BB));
        let odd_a = d[3].minus(d[1].times(BB)).times(A);
        let even_b = d[4].minus(d[2].times(AA));
        let odd_b = d[3].minus(d[1].times(AA)).times(B);
        [
            ends(d[0], d[2], d[4]),
            even_a.add(odd_a),
            even_a.minus(odd_a),
            even_b.add(odd_b),
            even_b.minus(odd_b),
            ends(d[1], d[3], d[5]),
        ]
    }
}

/// The rows of B^T that belong to the points 0 and infinity.
#[inline(always)]
unsafe fn ends<V: Quads>(x: V, y: V, z: V) -> V {
    // SAFETY: by the contract of this module.
    unsafe { x.times(AA * BB).minus(y.times(AA + BB)).add(z) }
}

/// A^T of six numbers.
#[inline(always)]
pub unsafe fn output_transform<V: Quads>(m: [V; SIGHT]) -> [V; SIDE] {
    // SAFETY: by the contract of this module.
    unsafe {
        let sum_a = m[1].add(m[2]);
        let difference_a = m[1].minus(m[2]);
        let sum_b = m[3].add(m[4]);
        let difference_b = m[3].minus(m[4]);
        let cubes = difference_a.times(A * AA).add(difference_b.times(B * BB));
        [
            m[0].add(sum_a).add(sum_b),
            difference_a.times(A).add(difference_b.times(B)),
            sum_a.times(AA).add(sum_b.times(BB)),
            cubes.add(m[5]),
        ]
    }
}

/// G of three numbers.
#[inline(always)]
pub unsafe fn kernel_transform<V: Quads>([x, y, z]: [V; 3]) -> [V; SIGHT] {
    // The reciprocals of what the polynomial x (x^2 - A^2) (x^2 - B^2) slopes by at 0, A and B.
    const ZERO: f32 = 1.0 / (AA * BB);
    const AT_A: f32 = 1.0 / (2.0 * AA * (AA - BB));
    const AT_B: f32 = 1.0 / (2.0 * BB * (BB - AA));
    // SAFETY: by the contract of this module.
    unsafe {
        let even_a = x.times(AT_A).add(z.times(AT_A * AA));
        let odd_a = y.times(AT_A * A);
        let even_b = x.times(AT_B).add(z.times(AT_B * BB));
        let odd_b = y.times(AT_B * B);
        [
            x.times(ZERO),
            even_a.add(odd_a),
            even_a.minus(odd_a),
            even_b.add(odd_b),
            even_b.minus(odd_b),
            z,
        ]
    }
}
