//! What the transforms ask of vectors beyond what products ask: differences, and quads. A quad is
//! four vectors of one line of pixels, or the same pixels as the four columns of as many tiles side
//! by side as a vector has lanes.
//!
//! Every operation is rounded by itself (no fused multiply-add), so the bits are the same for every
//! instruction set.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

use super::extents::SIDE;
use crate::runtime::cpu::simd::Level;
use crate::runtime::cpu::vector::{Lanes, Vector};

/// Vectors of `f32` that transforms are written with.
///
/// SAFETY of every function: that of [`Vector`].
pub trait Quads: Vector {
    unsafe fn minus(self, other: Self) -> Self;
    unsafe fn times(self, factor: f32) -> Self;
    /// `x` above 0, `slope x` elsewhere.
    unsafe fn leaky(self, slope: f32) -> Self;
    /// From pixels to columns: lane `t` of column `j` is pixel `4 t + j`.
    unsafe fn to_columns(pixels: [Self; SIDE]) -> [Self; SIDE];
    /// From columns to pixels.
    unsafe fn to_pixels(columns: [Self; SIDE]) -> [Self; SIDE];
    /// Each lane has the number of the next one, and the last has `next`.
    unsafe fn followed_by(self, next: f32) -> Self;
}

/// Work written for any vectors.
pub trait VectorKernel {
    /// SAFETY: the processor has the instructions of `V`. To be marked `#[inline(always)]`: it is
    /// compiled where they may be used.
    unsafe fn run<V: Quads>(self);
}

/// Runs `kernel` with the vectors of the current level.
pub fn run(kernel: impl VectorKernel) {
    // SAFETY: a level is current only if the processor has it.
    unsafe {
        match Level::current() {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => avx512(kernel),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => avx2(kernel),
            Level::Portable => kernel.run::<Lanes>(),
        }
    }
}

/// SAFETY: the processor has AVX-512.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512bw")]
unsafe fn avx512(kernel: impl VectorKernel) {
    // SAFETY: by the contract of this function.
    unsafe { kernel.run::<__m512>() }
}

/// SAFETY: the processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(kernel: impl VectorKernel) {
    // SAFETY: by the contract of this function.
    unsafe { kernel.run::<__m256>() }
}

/// Which lanes of `a` (below 16) and `b` (from 16 on) the halves of two columns take: `first` and
/// the one after it, of eight tiles.
#[cfg(target_arch = "x86_64")]
const fn columns_of(first: i32) -> [i32; 16] {
    let mut lanes = [0; 16];
    let mut tile = 0;
    while tile < 8 {
        lanes[tile] = 4 * tile as i32 + first;
        lanes[8 + tile] = 4 * tile as i32 + first + 1;
        tile += 1;
    }
    lanes
}

/// The inverse: which lanes of columns 0 and 1 (below 16) and of columns 2 and 3 (from 16 on) four
/// tiles' pixels take, from tile `first` of eight.
#[cfg(target_arch = "x86_64")]
const fn pixels_of(first: i32) -> [i32; 16] {
    let mut lanes = [0; 16];
    let mut lane = 0;
    while lane < 16 {
        let column = lane as i32 % 4;
        lanes[lane] = column / 2 * 16 + column % 2 * 8 + first + lane as i32 / 4;
        lane += 1;
    }
    lanes
}

#[cfg(target_arch = "x86_64")]
impl Quads for __m512 {
    #[inline(always)]
    unsafe fn minus(self, other: Self) -> Self {
        // SAFETY: by the contract of the trait, here and below.
        unsafe { _mm512_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn times(self, factor: f32) -> Self {
        // SAFETY: see above.
        unsafe { _mm512_mul_ps(_mm512_set1_ps(factor), self) }
    }

    #[inline(always)]
    unsafe fn leaky(self, slope: f32) -> Self {
        // SAFETY: see above.
        unsafe {
            let above = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, _mm512_setzero_ps());
            _mm512_mask_mov_ps(self.times(slope), above, self)
        }
    }

    #[inline(always)]
    unsafe fn to_columns([a, b, c, d]: [Self; SIDE]) -> [Self; SIDE] {
        // SAFETY: see above; the constants are as long as a vector.
        unsafe {
            let first = _mm512_loadu_si512(const { &columns_of(0) }.as_ptr().cast());
            let last = _mm512_loadu_si512(const { &columns_of(2) }.as_ptr().cast());
            // Two columns of the first eight tiles, and of the last eight.
            let low = [first, last].map(|lanes| _mm512_permutex2var_ps(a, lanes, b));
            let high = [first, last].map(|lanes| _mm512_permutex2var_ps(c, lanes, d));
            [
                // 0x44 takes the lower halves of both, 0xee the upper ones.
                _mm512_shuffle_f32x4::<0x44>(low[0], high[0]),
                _mm512_shuffle_f32x4::<0xee>(low[0], high[0]),
                _mm512_shuffle_f32x4::<0x44>(low[1], high[1]),
                _mm512_shuffle_f32x4::<0xee>(low[1], high[1]),
            ]
        }
    }

    #[inline(always)]
    unsafe fn to_pixels([a, b, c, d]: [Self; SIDE]) -> [Self; SIDE] {
        // SAFETY: see above; the constants are as long as a vector.
        unsafe {
            let first = _mm512_loadu_si512(const { &pixels_of(0) }.as_ptr().cast());
            let last = _mm512_loadu_si512(const { &pixels_of(4) }.as_ptr().cast());
            let low = [
                _mm512_shuffle_f32x4::<0x44>(a, b),
                _mm512_shuffle_f32x4::<0x44>(c, d),
            ];
            let high = [
                _mm512_shuffle_f32x4::<0xee>(a, b),
                _mm512_shuffle_f32x4::<0xee>(c, d),
            ];
            [
                _mm512_permutex2var_ps(low[0], first, low[1]),
                _mm512_permutex2var_ps(low[0], last, low[1]),
                _mm512_permutex2var_ps(high[0], first, high[1]),
                _mm512_permutex2var_ps(high[0], last, high[1]),
            ]
        }
    }

    #[inline(always)]
    unsafe fn followed_by(self, next: f32) -> Self {
        // SAFETY: see above.
        unsafe {
            let [next, lanes] = [_mm512_set1_ps(next), self].map(|x| _mm512_castps_si512(x));
            _mm512_castsi512_ps(_mm512_alignr_epi32::<1>(next, lanes))
        }
    }
}

/// Turns the four by four numbers in each half of four vectors.
/// SAFETY: the processor has AVX2.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn turn_halves([a, b, c, d]: [__m256; SIDE]) -> [__m256; SIDE] {
    // SAFETY: by the contract of this function.
    unsafe {
        let ab = [_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)];
        let cd = [_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d)];
        [
            _mm256_shuffle_ps::<0x44>(ab[0], cd[0]),
            _mm256_shuffle_ps::<0xee>(ab[0], cd[0]),
            _mm256_shuffle_ps::<0x44>(ab[1], cd[1]),
            _mm256_shuffle_ps::<0xee>(ab[1], cd[1]),
        ]
    }
}

#[cfg(target_arch = "x86_64")]
impl Quads for __m256 {
    #[inline(always)]
    unsafe fn minus(self, other: Self) -> Self {
        // SAFETY: by the contract of the trait, here and below.
        unsafe { _mm256_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn times(self, factor: f32) -> Self {
        // SAFETY: see above.
        unsafe { _mm256_mul_ps(_mm256_set1_ps(factor), self) }
    }

    #[inline(always)]
    unsafe fn leaky(self, slope: f32) -> Self {
        // SAFETY: see above.
        unsafe {
            let above = _mm256_cmp_ps::<_CMP_GT_OQ>(self, _mm256_setzero_ps());
            _mm256_blendv_ps(self.times(slope), self, above)
        }
    }

    #[inline(always)]
    unsafe fn to_columns(pixels: [Self; SIDE]) -> [Self; SIDE] {
        // SAFETY: see above. Turned by halves, the even tiles come before the odd ones.
        unsafe {
            let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
            turn_halves(pixels).map(|column| _mm256_permutevar8x32_ps(column, order))
        }
    }

    #[inline(always)]
    unsafe fn to_pixels(columns: [Self; SIDE]) -> [Self; SIDE] {
        // SAFETY: see above.
        unsafe {
            let order = _mm256_setr_epi32(0, 2, 4, 6, 1, 3, 5, 7);
            turn_halves(columns.map(|column| _mm256_permutevar8x32_ps(column, order)))
        }
    }

    #[inline(always)]
    unsafe fn followed_by(self, next: f32) -> Self {
        // SAFETY: see above.
        unsafe {
            let order = _mm256_setr_epi32(1, 2, 3, 4, 5, 6, 7, 7);
            let moved = _mm256_permutevar8x32_ps(self, order);
            _mm256_blend_ps::<0x80>(moved, _mm256_set1_ps(next))
        }
    }
}

impl Quads for Lanes {
    #[inline(always)]
    unsafe fn minus(self, other: Self) -> Self {
        Lanes(std::array::from_fn(|i| self.0[i] - other.0[i]))
    }

    #[inline(always)]
    unsafe fn times(self, factor: f32) -> Self {
        Lanes(self.0.map(|x| factor * x))
    }

    #[inline(always)]
    unsafe fn leaky(self, slope: f32) -> Self {
        Lanes(self.0.map(|x| if x > 0.0 { x } else { slope * x }))
    }

    #[inline(always)]
    unsafe fn to_columns(pixels: [Self; SIDE]) -> [Self; SIDE] {
        std::array::from_fn(|column| Lanes(pixels.map(|tile| tile.0[column])))
    }

    #[inline(always)]
    unsafe fn to_pixels(columns: [Self; SIDE]) -> [Self; SIDE] {
        std::array::from_fn(|tile| Lanes(columns.map(|column| column.0[tile])))
    }

    #[inline(always)]
    unsafe fn followed_by(self, next: f32) -> Self {
        let [_, b, c, d] = self.0;
        Lanes([b, c, d, next])
    }
}
