//! One step of Adam.

use rayon::prelude::*;

use super::step::Step;
use crate::runtime::cpu::chunks::CHUNK;
use crate::runtime::cpu::simd::vectorize;

/// Advances the parameter and both moments.
pub fn advance(step: Step, parameter: &mut [f32], gradient: &[f32], m: &mut [f32], v: &mut [f32]) {
    let chunks = parameter
        .par_chunks_mut(CHUNK)
        .zip(gradient.par_chunks(CHUNK));
    let moments = m.par_chunks_mut(CHUNK).zip(v.par_chunks_mut(CHUNK));
    chunks
        .zip(moments)
        .for_each(|((parameter, gradient), (m, v))| {
            vectorize(
                #[inline(always)]
                || {
                    for (((p, &g), m), v) in parameter.iter_mut().zip(gradient).zip(m).zip(v) {
                        *m = step.beta1 * *m + (1.0 - step.beta1) * g;
                        *v = step.beta2 * *v + (1.0 - step.beta2) * g * g;
                        // Algorithm 1, with the corrections 1 - beta^t in `rate` and `root`: none
                        // is divided by here.
                        *p = *p * step.keep - step.rate * *m / (v.sqrt() * step.root + step.eps);
                    }
                },
            )
        });
}
