//! Functions of single numbers that vectorise: no branches, no table, no call into the C library.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI, LOG2_E};

/// Adding and subtracting 1.5 * 2^23 rounds to the nearest integer, which then lies in the low bits
/// of the sum.
const ROUND: f32 = 12_582_912.0;
/// ln 2 in two parts: the high part has few enough bits for its multiples to be exact.
const LN2_HIGH: f32 = 355.0 / 512.0;
const LN2_LOW: f32 = -2.121_944_4e-4;

/// Evaluates a polynomial whose highest coefficient comes first, by Horner's rule. A macro, since a
/// loop over the coefficients keeps the loop around it from becoming vectors.
macro_rules! polynomial {
    ($x:expr; $first:expr $(, $next:expr)* $(,)?) => {{
        let value: f32 = $first;
        $(let value = value * $x + $next;)*
        value
    }};
}

/// The exponential function, to a relative error of about 1e-7; clamped to the range of normal
/// numbers. NaN stays NaN.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    // Beyond these the result is not a normal number, and its exponent could not be put together.
    let x = x.clamp(-87.3, 88.3);
    let rounded = x * LOG2_E + ROUND;
    let n = rounded - ROUND;
    // x = n ln 2 + r with r within ln 2 / 2, where the series is short. The high part's product is
    // exact, so nothing is lost where r is small.
    let r = (x - n * LN2_HIGH) - n * LN2_LOW;
    let fraction = polynomial!(r; 1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0);
    // 2^n by its bits: n lies in the low bits of `rounded`, and the shift drops the rest.
    let power = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    fraction * power
}

/// `1 / (1 + exp(-x))`.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The error function, to a relative error of about 2e-7: a polynomial in `x^2` below 1, and `1 -
/// exp(-x^2) p(t)` with `t = 2 / (2 + x)` above. Both are Chebyshev fits.
#[inline(always)]
pub fn erf(x: f32) -> f32 {
    let magnitude = x.abs();
    let square = magnitude * magnitude;
    let inner = polynomial!(
        square; -9.673_59e-6, 1.126_825_4e-4, -8.484_396e-4, 5.221_053_5e-3, -2.686_543_8e-2, 0.112_837_83,
        -0.376_126_38, FRAC_2_SQRT_PI,
    );
    // Maps 0 to infinity onto 1 to 0, where a polynomial can follow.
    let t = 2.0 / (2.0 + magnitude);
    let outer = polynomial!(
        t; -1.133_854e-2, -2.819_593_4e-2, 0.268_488_6, -0.524_538_76, 0.347_045_87, -7.931_277e-2, 0.225_032_69,
        0.237_641_2, 0.283_095_5, 0.282_046_7,
    );
    let near = magnitude * inner;
    // Both branches are computed and one is taken: a jump would end the vectors.
    let far = 1.0 - exp(-square) * t * outer;
    // Odd: the fits are for positive numbers.
    (if magnitude < 1.0 { near } else { far }).copysign(x)
}

/// The distribution function of the standard normal.
#[inline(always)]
pub fn normal_cdf(x: f32) -> f32 {
    0.5 + 0.5 * erf(x * FRAC_1_SQRT_2)
}

/// The density of the standard normal.
#[inline(always)]
pub fn normal_density(x: f32) -> f32 {
    0.398_942_3 * exp(-0.5 * x * x)
}

/// `x sigmoid(x)`.
#[inline(always)]
pub fn silu(x: f32) -> f32 {
    x * sigmoid(x)
}

/// The derivative of [`silu`].
#[inline(always)]
pub fn silu_slope(x: f32) -> f32 {
    let s = sigmoid(x);
    // The derivative of s is s (1 - s).
    s * (1.0 + x * (1.0 - s))
}

/// The derivative of `x normal_cdf(x)`.
#[inline(always)]
pub fn gelu_slope(x: f32) -> f32 {
    normal_cdf(x) + x * normal_density(x)
}

/// By CLIP's approximation, GELU is `x sigmoid(QUICK x)`.
pub const QUICK: f32 = 1.702;

/// The derivative of `x sigmoid(QUICK x)`.
#[inline(always)]
pub fn quick_gelu_slope(x: f32) -> f32 {
    let s = sigmoid(QUICK * x);
    s * (1.0 + QUICK * x * (1.0 - s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_right_to_two_units_in_the_last_place() {
        for i in -87_000..88_000 {
            let x = i as f32 * 1e-3;
            let exact = f64::from(x).exp();
            assert!(
                (f64::from(exp(x)) / exact - 1.0).abs() < 1.6e-7,
                "exp({x}) is {}, not {exact}",
                exp(x)
            );
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(f32::NAN).is_nan());
        assert!(exp(-1e30) < 1.3e-38 && exp(1e30).is_finite());
    }

    #[test]
    fn erf_matches_its_series() {
        for i in -350..350 {
            let x = f64::from(i) * 0.01 + 0.001;
            // 2/sqrt(pi) times the sum of (-1)^n x^(2n+1) / (n! (2n+1)).
            let mut term = x;
            let mut sum = x;
            for n in 1..80 {
                term *= -x * x / f64::from(n);
                sum += term / f64::from(2 * n + 1);
            }
            let exact = sum * std::f64::consts::FRAC_2_SQRT_PI;
            assert!(
                (f64::from(erf(x as f32)) / exact - 1.0).abs() < 4e-7,
                "erf({x}) is {}, not {exact}",
                erf(x as f32)
            );
        }
        assert_eq!((erf(0.0), erf(-9.0)), (0.0, -1.0));
    }
}
