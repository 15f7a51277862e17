//! The hash grid's corners and look-ups with AVX-512: a group of positions at once, one gather per
//! corner. Same bits as the portable kernel of [`super::hash`], to which it says no more than "this
//! machine can".
#![allow(unsafe_code)]
#![allow(clippy::needless_range_loop)] // Corners are numbers with meaning: bit 0 is x, bit 1 is y, bit 2 is z.

use super::hash::{CORNERS, Corners, Entry, Kernel, LANES, PRIMES};
use crate::config::{FEATURES, Level};
use pulp::x86::V4;
use std::arch::x86_64::*;

/// Proof that the machine has AVX-512. Its kernels must be inlined into code run by its
/// [`pulp::Simd::vectorize`].
#[derive(Clone, Copy)]
pub struct Avx512(pub V4);

impl Avx512 {
    /// Looks at the machine.
    pub fn new() -> Option<Self> {
        V4::try_new().map(Self)
    }

    /// Entries and weights of a group's corners in registers. Loops, not closures: only code
    /// inlined into the caller's loop is compiled for AVX-512.
    #[inline(always)]
    fn vertices(
        self,
        level: &Level,
        positions: [&[f32; LANES]; 3],
    ) -> ([__m512i; CORNERS], [__m512; CORNERS]) {
        // SAFETY: `self` proves that the machine has AVX-512F; the loads read whole arrays of 16
        // floats.
        unsafe {
            let scale = _mm512_set1_ps(level.scale);
            let half = _mm512_set1_ps(0.5);
            let one = _mm512_set1_ps(1.0);
            // cell, share: [axis][16 lanes]. A share says how much the corner on that side counts:
            // 1 - f below, f above.
            let mut cell = [_mm512_setzero_si512(); 3];
            let mut share = [[one; 2]; 3];
            for axis in 0..3 {
                // Half a cell's shift, as in the portable kernel. Two steps: a fused one would
                // round otherwise than that.
                let place = _mm512_add_ps(
                    _mm512_mul_ps(_mm512_loadu_ps(positions[axis].as_ptr()), scale),
                    half,
                );
                cell[axis] = _mm512_cvttps_epi32(place);
                share[axis][1] = _mm512_sub_ps(place, _mm512_cvtepi32_ps(cell[axis]));
                share[axis][0] = _mm512_sub_ps(one, share[axis][1]);
            }
            let mut weight = [one; CORNERS];
            for corner in 0..CORNERS {
                // (x y) z, in the portable kernel's order: products of floats are not associative.
                let across = _mm512_mul_ps(share[0][corner & 1], share[1][corner >> 1 & 1]);
                weight[corner] = _mm512_mul_ps(across, share[2][corner >> 2]);
            }
            (
                if level.dense {
                    self.dense(level, cell)
                } else {
                    self.hashed(level, cell)
                },
                weight,
            )
        }
    }

    #[inline(always)]
    fn dense(self, level: &Level, [x, y, z]: [__m512i; 3]) -> [__m512i; CORNERS] {
        // SAFETY: `self` proves that the machine has AVX-512F.
        unsafe {
            let nx = level.resolution[0] as i32;
            let ny = level.resolution[1] as i32;
            let entries = _mm512_set1_epi32(level.entries as i32);
            let last = _mm512_set1_epi32(level.entries as i32 - 1);
            // Entry (z ny + y) nx + x, of 16 positions at once.
            let row = _mm512_add_epi32(y, _mm512_mullo_epi32(_mm512_set1_epi32(ny), z));
            let first = _mm512_add_epi32(x, _mm512_mullo_epi32(_mm512_set1_epi32(nx), row));
            let mut entry = [first; CORNERS];
            for corner in 0..CORNERS as i32 {
                let offset = (corner & 1) + nx * ((corner >> 1 & 1) + ny * (corner >> 2));
                // Past the end, i - entries is the smaller unsigned number: a wrap without a
                // branch. What is outside the box is held at the last entry, so that a gather never
                // leaves the table.
                let i = _mm512_add_epi32(first, _mm512_set1_epi32(offset));
                entry[corner as usize] =
                    _mm512_min_epu32(_mm512_min_epu32(i, _mm512_sub_epi32(i, entries)), last);
            }
            entry
        }
    }

    #[inline(always)]
    fn hashed(self, level: &Level, [x, y, z]: [__m512i; 3]) -> [__m512i; CORNERS] {
        // SAFETY: `self` proves that the machine has AVX-512F.
        unsafe {
            let p = _mm512_set1_epi32(PRIMES[0] as i32);
            let q = _mm512_set1_epi32(PRIMES[1] as i32);
            let mask = _mm512_set1_epi32(level.entries as i32 - 1);
            let y = _mm512_mullo_epi32(y, p);
            let z = _mm512_mullo_epi32(z, q);
            let x = [x, _mm512_add_epi32(x, _mm512_set1_epi32(1))];
            // (y + 1) p = y p + p: two multiplications do for eight corners.
            let y = [y, _mm512_add_epi32(y, p)];
            let z = [z, _mm512_add_epi32(z, q)];
            let mut entry = [mask; CORNERS];
            for corner in 0..CORNERS {
                let hash = _mm512_xor_si512(
                    _mm512_xor_si512(x[corner & 1], y[corner >> 1 & 1]),
                    z[corner >> 2],
                );
                entry[corner] = _mm512_and_si512(hash, mask);
            }
            entry
        }
    }
}

impl Kernel for Avx512 {
    #[inline(always)]
    fn corners(self, level: &Level, positions: [&[f32; LANES]; 3]) -> Corners {
        let (entry, weight) = self.vertices(level, positions);
        // SAFETY: a vector of sixteen numbers and an array of them are the same bytes.
        unsafe {
            Corners {
                entry: std::mem::transmute::<[__m512i; CORNERS], [[u32; LANES]; CORNERS]>(entry),
                weight: std::mem::transmute::<[__m512; CORNERS], [[f32; LANES]; CORNERS]>(weight),
            }
        }
    }

    #[inline(always)]
    fn look_up(
        self,
        level: &Level,
        table: &[Entry],
        positions: [&[f32; LANES]; 3],
    ) -> [[f32; FEATURES]; LANES] {
        assert_eq!(
            table.len(),
            level.entries,
            "look_up: a table of another level"
        );
        let (entry, weight) = self.vertices(level, positions);
        // SAFETY: `self` proves that the machine has AVX-512F. An entry is two halves, four bytes,
        // and every index is below the table's length: hashes are masked to it (a power of two),
        // places in a dense level are limited to it.
        unsafe {
            let mut sum = [_mm512_setzero_ps(); FEATURES];
            for corner in 0..CORNERS {
                // An entry is two halves in 32 bits, so one gather brings both features.
                let pair = _mm512_i32gather_epi32::<4>(entry[corner], table.as_ptr().cast());
                let low = _mm512_cvtph_ps(_mm512_cvtepi32_epi16(pair));
                let high = _mm512_cvtph_ps(_mm512_cvtepi32_epi16(_mm512_srli_epi32::<16>(pair)));
                sum[0] = _mm512_fmadd_ps(low, weight[corner], sum[0]);
                sum[1] = _mm512_fmadd_ps(high, weight[corner], sum[1]);
            }
            let low = _mm512_castps_si512(_mm512_unpacklo_ps(sum[0], sum[1]));
            let high = _mm512_castps_si512(_mm512_unpackhi_ps(sum[0], sum[1]));
            // Each 128-bit part of `low` and `high` holds two pairs of lanes 4k, 4k + 1 and 4k + 2,
            // 4k + 3.
            let first = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11);
            let second = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
            std::mem::transmute::<[__m512i; 2], [[f32; FEATURES]; LANES]>([
                _mm512_permutex2var_epi64(low, first, high),
                _mm512_permutex2var_epi64(low, second, high),
            ])
        }
    }
}
