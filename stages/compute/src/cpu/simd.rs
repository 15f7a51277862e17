//! Choosing the widest vector instructions at run time. It knows instruction sets, and nothing of what is computed.
#![allow(unsafe_code)]

/// Runs `kernel` compiled for the widest vectors this processor has. Only what is inlined here is compiled anew, so
/// mark the closure (and closures that it calls) `#[inline(always)]`, and loop by `for`, not by `for_each`. Kernels
/// round every operation by itself (no fused multiply-add), so their bits are the same for every instruction set.
#[inline(always)]
pub fn vectorize<R>(kernel: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
            // SAFETY: the processor has just been asked for the features that the callee is compiled for.
            return unsafe { avx512(kernel) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: as above.
            return unsafe { avx2(kernel) };
        }
    }
    kernel()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq")]
fn avx512<R>(kernel: impl FnOnce() -> R) -> R {
    kernel()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<R>(kernel: impl FnOnce() -> R) -> R {
    kernel()
}
