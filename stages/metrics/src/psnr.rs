//! Peak signal-to-noise ratio of two pictures. Knows nothing of what either of them shows.

use crate::Image;

/// The PSNR of identical pictures, in dB. The true value is infinite, which JSON cannot say.
pub const MAX_PSNR: f64 = 100.0;

/// PSNR in dB of `image` against `truth`: `-10 log10(MSE)`, peak 1, over all pixels and channels of
/// the sRGB-encoded pictures clamped to 0..1. Symmetric; from 0 (black against white) to
/// [`MAX_PSNR`].
///
/// No border is cropped and no luma is taken, unlike the custom in super-resolution papers. Average
/// it over views, do not average the MSE (`docs/metrics.md`). Panics if the sizes differ.
pub fn psnr(truth: Image, image: Image) -> f64 {
    truth.assert_same_size(&image, "psnr");
    // Added on one thread in one order: the sum has the same bits for any number of threads.
    let squares: f64 = truth
        .clamped()
        .zip(image.clamped())
        .map(|(a, b)| squared_difference(a, b))
        .sum();
    from_mse(squares / (truth.width() * truth.height() * 3) as f64)
}

/// `-10 log10(mse)`, at most [`MAX_PSNR`].
pub(crate) fn from_mse(mse: f64) -> f64 {
    // At mse = 0 the logarithm is -inf, and the cap is what remains.
    (-10.0 * mse.log10()).min(MAX_PSNR)
}

/// The square of `a - b`, in f64 so that long sums lose nothing.
pub(crate) fn squared_difference(a: f32, b: f32) -> f64 {
    (f64::from(a) - f64::from(b)).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(count: usize) -> Vec<f32> {
        (0..count).map(|i| (i * 37 % 101) as f32 / 101.0).collect()
    }

    #[test]
    fn a_constant_error_of_a_tenth_is_20_db() {
        let dark = vec![0.3f32; 48];
        let light = vec![0.4f32; 48];
        let value = psnr(Image::new(4, 4, &dark), Image::new(4, 4, &light));
        assert!((value - 20.0).abs() < 1e-5, "{value}");
    }

    #[test]
    fn identical_pictures_reach_the_cap_and_black_against_white_the_floor() {
        let ramp = ramp(48);
        let black = vec![0.0; 48];
        let white = vec![1.0; 48];
        assert_eq!(
            psnr(Image::new(4, 4, &ramp), Image::new(4, 4, &ramp)),
            MAX_PSNR
        );
        assert_eq!(
            psnr(Image::new(4, 4, &black), Image::new(4, 4, &white)),
            0.0
        );
    }

    /// Oracle (g): against white, PSNR measures brightness only. Mean 0.40 and deviation 0.20 give
    /// the 3.98 dB that the paper's table prints.
    #[test]
    fn psnr_against_white_is_a_function_of_mean_and_deviation() {
        let white = vec![1.0; 300];
        let rgb = ramp(300);
        let values: Vec<f64> = rgb.iter().map(|&v| f64::from(v)).collect();
        let mean = values.iter().sum::<f64>() / 300.0;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 300.0;
        let expected = -10.0 * ((1.0 - mean).powi(2) + variance).log10();
        let value = psnr(Image::new(10, 10, &white), Image::new(10, 10, &rgb));
        assert!((value - expected).abs() < 1e-9, "{value} {expected}");

        let paper: Vec<f32> = (0..300)
            .map(|i| if i % 2 == 0 { 0.2 } else { 0.6 })
            .collect();
        let value = psnr(Image::new(10, 10, &white), Image::new(10, 10, &paper));
        assert!((value - 3.98).abs() < 0.005, "{value}");
    }
}
