//! Adam for a field's parameters (Kingma and Ba 2015): every step for matrices, here, and only when
//! touched for hash entries, in [`table`]. Knows nothing of what the gradients come from.

mod packed;
pub mod table;

use pulp::{Arch, Simd, WithSimd};
use std::sync::LazyLock;

// instant-ngp's decays and epsilon.
const BETA1: f32 = 0.9;
const BETA2: f32 = 0.99;
const EPSILON: f32 = 1e-15;
/// After so many steps the bias corrections are 1 in f32.
pub const CORRECTED: usize = 2048;

/// First and second moments of a dense parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub first: Vec<f32>,
    /// Running mean of its square.
    pub second: Vec<f32>,
}

impl Moments {
    /// Zero moments for `len` parameters.
    pub fn new(len: usize) -> Self {
        Self {
            first: vec![0.0; len],
            second: vec![0.0; len],
        }
    }
}

/// The bias corrections of step `n`: sqrt(1 - beta2^n) / (1 - beta1^n).
pub fn correction(n: i32) -> f64 {
    (1.0 - f64::from(BETA2).powi(n)).sqrt() / (1.0 - f64::from(BETA1).powi(n))
}

/// [`correction`] for n = 0 (which has none), 1, 2, ...
// A table, since every hash entry has a step count of its own.
static CORRECTIONS: LazyLock<[f32; CORRECTED + 1]> = LazyLock::new(|| {
    std::array::from_fn(|n| {
        if n == 0 {
            0.0
        } else {
            correction(n as i32) as f32
        }
    })
});

/// A step of some values: value, first and second moment after it.
#[inline(always)]
fn advance<S: Simd>(
    simd: S,
    [value, first, second]: [S::f32s; 3],
    gradient: S::f32s,
    rate: S::f32s,
) -> [S::f32s; 3] {
    let mean = |beta: f32, mean, fresh| {
        // Fused at every width, also where a machine has no vectors: so bits are the same.
        simd.mul_add_f32s(
            simd.splat_f32s(beta),
            mean,
            simd.mul_f32s(simd.splat_f32s(1.0 - beta), fresh),
        )
    };
    let first = mean(BETA1, first, gradient);
    let second = mean(BETA2, second, simd.mul_f32s(gradient, gradient));
    let size = simd.add_f32s(simd.sqrt_f32s(second), simd.splat_f32s(EPSILON));
    [
        simd.sub_f32s(value, simd.div_f32s(simd.mul_f32s(rate, first), size)),
        first,
        second,
    ]
}

/// Step number `step` (from 1) of matrices, with `l2` times the parameter added to its gradient.
/// Their sizes are multiples of 16.
pub fn update_dense(
    parameters: &mut [f32],
    gradient: &[f32],
    moments: &mut Moments,
    rate: f32,
    step: u32,
    l2: f32,
) {
    // Whole vectors at every width, of up to 16 lanes: none needs a rest of its own.
    assert!(
        parameters.len() == gradient.len() && parameters.len().is_multiple_of(16),
        "update_dense: sizes"
    );
    // Both corrections in one factor of the rate; epsilon is not corrected, as in instant-ngp.
    let rate = rate * CORRECTIONS[(step as usize).min(CORRECTED)];
    Arch::new().dispatch(UpdateDense {
        parameters,
        gradient,
        moments,
        rate,
        l2,
    });
}

struct UpdateDense<'a> {
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    moments: &'a mut Moments,
    rate: f32,
    l2: f32,
}

impl WithSimd for UpdateDense<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let rate = simd.splat_f32s(self.rate);
        let l2 = simd.splat_f32s(self.l2);
        let first = S::as_mut_simd_f32s(&mut self.moments.first).0.iter_mut();
        let moments = first.zip(S::as_mut_simd_f32s(&mut self.moments.second).0);
        let parameters = S::as_mut_simd_f32s(self.parameters)
            .0
            .iter_mut()
            .zip(S::as_simd_f32s(self.gradient).0);
        for ((parameter, gradient), (first, second)) in parameters.zip(moments) {
            // L2 in the gradient, not decoupled: it goes through the moments as in instant-ngp.
            let gradient = simd.mul_add_f32s(l2, *parameter, *gradient);
            [*parameter, *first, *second] =
                advance(simd, [*parameter, *first, *second], gradient, rate);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate() {
        let mut parameters = [1.0; 16];
        let mut gradient = [0.3; 16];
        gradient[1] = -7.0;
        update_dense(
            &mut parameters,
            &gradient,
            &mut Moments::new(16),
            0.01,
            1,
            0.0,
        );
        assert!((parameters[0] - 0.99).abs() < 1e-6 && (parameters[1] - 1.01).abs() < 1e-6);
    }

    #[test]
    fn l2_pulls_towards_zero() {
        let mut parameters = [1.0; 16];
        update_dense(
            &mut parameters,
            &[0.0; 16],
            &mut Moments::new(16),
            0.01,
            1,
            1e-6,
        );
        assert!((parameters[0] - 0.99).abs() < 1e-6);
    }
}
