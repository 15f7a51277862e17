//! Choosing vector instructions at run time. It knows instruction sets, and nothing of what is
//! computed.
#![allow(unsafe_code)]

use std::sync::OnceLock;

/// The instruction sets that kernels exist for. On aarch64 the portable kernels are compiled to
/// NEON.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// What every processor of the target has.
    Portable,
    /// AVX2 with FMA: eight lanes.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F, DQ and BW.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// Set to `portable` or `avx2`, this environment variable keeps this crate from using wider
/// vectors.
const LIMIT: &str = "COMPUTE_SIMD";

impl Level {
    /// The level that all kernels of this process use: the widest that the processor has and
    /// `COMPUTE_SIMD` permits.
    pub fn current() -> Level {
        // Asked once: all kernels of a process use one level, or their bits would not go together.
        static CURRENT: OnceLock<Level> = OnceLock::new();
        *CURRENT.get_or_init(|| match std::env::var(LIMIT).as_deref() {
            Ok("portable") => Level::Portable,
            #[cfg(target_arch = "x86_64")]
            Ok("avx2") => Level::widest().min(Level::Avx2),
            _ => Level::widest(),
        })
    }

    pub fn name(self) -> &'static str {
        match self {
            Level::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => "avx512",
        }
    }

    /// Whether there are dot products of bf16 pairs (AVX-512 BF16).
    pub fn has_bf16_dot(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return self == Level::Avx512 && is_x86_feature_detected!("avx512bf16");
        #[cfg(not(target_arch = "x86_64"))]
        false
    }

    #[cfg(target_arch = "x86_64")]
    fn widest() -> Level {
        let has_avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        let has_avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw");
        match (has_avx512, has_avx2) {
            (true, true) => Level::Avx512,
            (false, true) => Level::Avx2,
            _ => Level::Portable,
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn widest() -> Level {
        Level::Portable
    }
}

/// Runs `kernel` compiled for the current level. Only what is inlined here is compiled anew, so
/// mark the closure (and closures that it calls) `#[inline(always)]`, and loop by `for`, not by
/// `for_each`. Kernels round every operation by itself (no fused multiply-add), so their bits are
/// the same for every instruction set.
#[inline(always)]
pub fn vectorize<R>(kernel: impl FnOnce() -> R) -> R {
    match Level::current() {
        // SAFETY: a level is current only if the processor has it.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { avx512(kernel) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { avx2(kernel) },
        Level::Portable => kernel(),
    }
}

/// Asks for values that will soon be read or written, where they may still lie in memory and too
/// few lie side by side for the processor to guess it.
#[inline(always)]
pub fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    for line in values.chunks(64 / size_of::<T>()) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint, which changes nothing that a program can see, wherever it points.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512bw")]
fn avx512<R>(kernel: impl FnOnce() -> R) -> R {
    kernel()
}

#[cfg(target_arch = "x86_64")]
// Without FMA, so that the compiler cannot fuse what must be rounded twice.
#[target_feature(enable = "avx2")]
fn avx2<R>(kernel: impl FnOnce() -> R) -> R {
    kernel()
}
