//! exp and the logistic function with the same bits on every machine. Knows nothing of what they
//! are used for.
//!
//! A C library's `expf` differs from one build to the next; this one uses only operations that IEEE
//! 754 rounds exactly, and compilers turn loops over it into SIMD code.

/// e^x to a relative error below 3e-7; the exponent is held to [-87, 88], where f32 ends.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    const ROUND: f32 = 12_582_912.0; // 1.5 * 2^23: adding and subtracting it rounds to a whole number.
    let x = x.clamp(-87.0, 88.0);
    let n = (x * std::f32::consts::LOG2_E + ROUND) - ROUND;
    // r lies within ln 2 / 2, where the series is short; the first product is exact.
    let r = (x - n * LN2_HIGH) - n * LN2_LOW;
    let tail = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0)));
    // Taylor's series to the seventh power: for |r| below 0.35 the next term is below 1e-8.
    let series = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * tail)));
    // 2^n, by its exponent's bits: the clamp keeps n + 127 within 1 to 254.
    series * f32::from_bits(((n as i32 + 127) as u32) << 23)
}

/// 1 / (1 + e^-x).
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_right_to_a_few_units_in_the_last_place() {
        for i in -8700..=8800 {
            let x = i as f32 * 0.01;
            let want = f64::from(x).exp();
            assert!(
                (f64::from(exp(x)) / want - 1.0).abs() < 3e-7,
                "exp({x}) = {} but {want}",
                exp(x)
            );
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(-1e9) < 1e-37 && exp(1e9).is_finite());
    }

    #[test]
    fn sigmoid_is_the_logistic_function() {
        assert_eq!(sigmoid(0.0), 0.5);
        assert!(
            (sigmoid(2.0) - 0.880_797).abs() < 1e-6 && (sigmoid(-2.0) - 0.119_203).abs() < 1e-6
        );
    }
}
