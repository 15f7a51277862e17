//! The vectors that the innermost loops of products are written with, one type per instruction set.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

/// Some `f32` side by side.
///
/// SAFETY of every function: the processor has the instruction set, and pointers are good for
/// [`LANES`](Self::LANES) values. They must be inlined into a function compiled for that
/// instruction set.
pub trait Vector: Copy {
    const LANES: usize;
    /// Rows of a tile two vectors wide that the registers hold.
    const TALL: usize;

    unsafe fn splat(value: f32) -> Self;
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    /// `self * factor + sum`.
    unsafe fn multiply_add(self, factor: Self, sum: Self) -> Self;
    unsafe fn add(self, other: Self) -> Self;
    /// Lanes read as pairs of bf16: the lower of each pair, as `f32`.
    unsafe fn lower(self) -> Self;
    /// The upper of each pair.
    unsafe fn upper(self) -> Self;
}

macro_rules! x86_vector {
    ($type:ty, $lanes:expr, $tall:expr, $splat:ident, $load:ident, $store:ident, $fma:ident, $add:ident,
     $lower:expr, $upper:expr) => {
        #[cfg(target_arch = "x86_64")]
        impl Vector for $type {
            const LANES: usize = $lanes;
            const TALL: usize = $tall;

            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                // SAFETY: by the contract of the trait, here and below.
                unsafe { $splat(value) }
            }

            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                // SAFETY: see above.
                unsafe { $load(from) }
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                // SAFETY: see above.
                unsafe { $store(to, self) }
            }

            #[inline(always)]
            unsafe fn multiply_add(self, factor: Self, sum: Self) -> Self {
                // SAFETY: see above.
                unsafe { $fma(self, factor, sum) }
            }

            #[inline(always)]
            unsafe fn add(self, other: Self) -> Self {
                // SAFETY: see above.
                unsafe { $add(self, other) }
            }

            #[inline(always)]
            unsafe fn lower(self) -> Self {
                // SAFETY: see above.
                unsafe { $lower(self) }
            }

            #[inline(always)]
            unsafe fn upper(self) -> Self {
                // SAFETY: see above.
                unsafe { $upper(self) }
            }
        }
    };
}

x86_vector!(
    __m512,
    16,
    12,
    _mm512_set1_ps,
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_fmadd_ps,
    _mm512_add_ps,
    |x| _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(x))),
    |x| _mm512_castsi512_ps(_mm512_and_si512(
        _mm512_castps_si512(x),
        _mm512_set1_epi32(UPPER as i32)
    ))
);
x86_vector!(
    __m256,
    8,
    6,
    _mm256_set1_ps,
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_fmadd_ps,
    _mm256_add_ps,
    |x| _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(x))),
    |x| _mm256_castsi256_ps(_mm256_and_si256(
        _mm256_castps_si256(x),
        _mm256_set1_epi32(UPPER as i32)
    ))
);

/// The bits of the upper bf16 of a pair.
const UPPER: u32 = 0xffff_0000;

/// Four lanes for the compiler to make vectors of: SSE2 or NEON.
#[derive(Clone, Copy)]
pub struct Lanes(pub [f32; 4]);

impl Vector for Lanes {
    const LANES: usize = 4;
    // Tiles that leave registers for the panel: 32 registers on aarch64, 16 of SSE2.
    const TALL: usize = if cfg!(target_arch = "aarch64") { 12 } else { 4 };

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Lanes([value; 4])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: by the contract of the trait; an array of `f32` is aligned as its elements are.
        Lanes(unsafe { *from.cast() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as above.
        unsafe { *to.cast() = self.0 }
    }

    #[inline(always)]
    unsafe fn multiply_add(self, factor: Self, sum: Self) -> Self {
        // Where the processor has no fused instruction, `mul_add` would be a call.
        let fused = |i: usize| self.0[i].mul_add(factor.0[i], sum.0[i]);
        let rounded = |i: usize| self.0[i] * factor.0[i] + sum.0[i];
        Lanes(if cfg!(target_arch = "aarch64") {
            std::array::from_fn(fused)
        } else {
            std::array::from_fn(rounded)
        })
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        Lanes(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }

    #[inline(always)]
    unsafe fn lower(self) -> Self {
        Lanes(self.0.map(|x| f32::from_bits(x.to_bits() << 16)))
    }

    #[inline(always)]
    unsafe fn upper(self) -> Self {
        Lanes(self.0.map(|x| f32::from_bits(x.to_bits() & UPPER)))
    }
}

/// Vectors whose factors are pairs of bf16, and whose sums are `f32`.
#[derive(Clone, Copy)]
pub struct Pairs<V>(V);

/// Vectors whose factors are pairs of bf16, multiplied by the processor's own dot product.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub struct Dots(__m512);

macro_rules! pair_vector {
    ($type:ty, $vector:ty $(, $generic:ident)?; |$a:ident, $b:ident, $sum:ident| $product:expr) => {
        impl$(<$generic: Vector>)? Vector for $type {
            const LANES: usize = <$vector>::LANES;
            const TALL: usize = <$vector>::TALL;

            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                // SAFETY: by the contract of the trait, here and below.
                Self(unsafe { <$vector>::splat(value) })
            }

            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                // SAFETY: see above.
                Self(unsafe { <$vector>::load(from) })
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                // SAFETY: see above.
                unsafe { self.0.store(to) }
            }

            #[inline(always)]
            unsafe fn multiply_add(self, factor: Self, sum: Self) -> Self {
                let $a = self.0;
                let $b = factor.0;
                let $sum = sum.0;
                // SAFETY: see above.
                Self(unsafe { $product })
            }

            #[inline(always)]
            unsafe fn add(self, other: Self) -> Self {
                // SAFETY: see above.
                Self(unsafe { self.0.add(other.0) })
            }

            #[inline(always)]
            unsafe fn lower(self) -> Self {
                // SAFETY: see above.
                Self(unsafe { self.0.lower() })
            }

            #[inline(always)]
            unsafe fn upper(self) -> Self {
                // SAFETY: see above.
                Self(unsafe { self.0.upper() })
            }
        }
    };
}

pair_vector!(Pairs<V>, V, V; |a, b, sum| a.upper().multiply_add(b.upper(), a.lower().multiply_add(b.lower(), sum)));
#[cfg(target_arch = "x86_64")]
pair_vector!(Dots, __m512; |a, b, sum| {
    _mm512_dpbf16_ps(sum, std::mem::transmute::<__m512, __m512bh>(a), std::mem::transmute::<__m512, __m512bh>(b))
});
