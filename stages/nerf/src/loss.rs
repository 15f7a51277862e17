//! How far a colour is from the photo's, and in which direction. Knows nothing of where either
//! comes from.

/// The smooth L1 loss of one residual: r^2 / (2 beta) below `beta`, |r| - beta / 2 above (Huber
/// 1964). For colours in [0, 1] and beta = 1 that is exactly half the squared error.
pub fn smooth_l1(residual: f32, beta: f32) -> f32 {
    let size = residual.abs();
    if size < beta {
        0.5 * size * size / beta
    } else {
        size - 0.5 * beta
    }
}

/// The derivative of [`smooth_l1`].
pub fn smooth_l1_backward(residual: f32, beta: f32) -> f32 {
    (residual / beta).clamp(-1.0, 1.0)
}

/// Peak signal-to-noise ratio in dB of a mean squared error of values in [0, 1]; at most 100.
pub fn psnr(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.max(1e-10).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_l1_of_colours_is_half_the_squared_error() {
        for i in 0..=100 {
            let residual = i as f32 / 50.0 - 1.0;
            assert_eq!(smooth_l1(residual, 1.0), 0.5 * residual * residual);
            assert_eq!(smooth_l1_backward(residual, 1.0), residual);
        }
    }

    #[test]
    fn the_derivative_matches_differences_on_both_branches() {
        for residual in [-0.9, -0.12, -0.05, 0.02, 0.3] {
            let numeric =
                (smooth_l1(residual + 1e-3, 0.1) - smooth_l1(residual - 1e-3, 0.1)) / 2e-3;
            assert!(
                (numeric - smooth_l1_backward(residual, 0.1)).abs() < 1e-3,
                "{residual}: {numeric}"
            );
        }
    }

    #[test]
    fn a_mean_squared_error_of_a_hundredth_is_20_db() {
        assert!((psnr(0.01) - 20.0).abs() < 1e-12);
        assert_eq!(psnr(0.0), 100.0);
    }
}
