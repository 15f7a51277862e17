//! Structural similarity of two pictures (Wang et al. 2004). Knows nothing of what either of them
//! shows.

use crate::{Image, gaussian};

/// `(K1 L)^2` and `(K2 L)^2` for the data range L = 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// SSIM of `image` against `truth`, from -1 to 1; 1 for identical pictures. `None` if a side is
/// below 11 pixels.
///
/// Measured on sRGB-encoded numbers clamped to 0..1, data range 1, K1 = 0.01, K2 = 0.03, means and
/// (biased) variances under an 11x11 Gaussian of sigma 1.5. Border rule: only places where the
/// whole window fits count, so five pixels on each side are centre of none. Channel rule: the mean
/// of the three channels' means. This is
/// `skimage.metrics.structural_similarity(gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False, data_range=1, channel_axis=2)`. Panics if the sizes differ.
pub fn ssim(truth: Image, image: Image) -> Option<f64> {
    truth.assert_same_size(&image, "ssim");
    // Padding would let made-up pixels count; a smaller picture has no value instead.
    let fits = truth.width().min(truth.height()) > 2 * gaussian::RADIUS;
    let channel = |c| ssim_plane(&truth.channel(c), &image.channel(c), truth.width());
    fits.then(|| (0..3).map(channel).sum::<f64>() / 3.0)
}

/// SSIM of two planes of the same size, at least 11x11.
fn ssim_plane(x: &[f64], y: &[f64], width: usize) -> f64 {
    let product =
        |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let mean_x = gaussian::average(x, width);
    let mean_y = gaussian::average(y, width);
    let xx = gaussian::average(&product(x, x), width);
    let yy = gaussian::average(&product(y, y), width);
    let xy = gaussian::average(&product(x, y), width);
    let at = |i: usize| {
        let mx = mean_x[i];
        let my = mean_y[i];
        // In f64 these differences cancel far below C2.
        let variance_x = xx[i] - mx * mx;
        let variance_y = yy[i] - my * my;
        let covariance = xy[i] - mx * my;
        // With C3 = C2 / 2 contrast and structure merge into one fraction (Wang et al., Eq. 13).
        let luminance = (2.0 * mx * my + C1) / (mx * mx + my * my + C1);
        luminance * (2.0 * covariance + C2) / (variance_x + variance_y + C2)
    };
    // Summed in order on one thread, so that threads change no bit.
    (0..xy.len()).map(at).sum::<f64>() / xy.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker(width: usize, height: usize, dark: f32, light: f32) -> Vec<f32> {
        let colour = |i: usize| {
            if (i % width + i / width).is_multiple_of(2) {
                dark
            } else {
                light
            }
        };
        (0..width * height).flat_map(|i| [colour(i); 3]).collect()
    }

    #[test]
    fn identical_pictures_score_one_and_inverted_ones_below_zero() {
        let board = checker(16, 12, 0.2, 0.8);
        let inverse = checker(16, 12, 0.8, 0.2);
        let board = Image::new(16, 12, &board);
        let inverse = Image::new(16, 12, &inverse);
        assert!((ssim(board, board).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(board, inverse).unwrap() < -0.9);
    }

    /// Without texture the variances vanish and only the luminance term is left.
    #[test]
    fn flat_pictures_follow_the_closed_form() {
        let a = vec![0.25f32; 11 * 11 * 3];
        let b = vec![0.75f32; 11 * 11 * 3];
        let expected = (2.0 * 0.25 * 0.75 + C1) / (0.0625 + 0.5625 + C1);
        let value = ssim(Image::new(11, 11, &a), Image::new(11, 11, &b)).unwrap();
        assert!((value - expected).abs() < 1e-12, "{value} {expected}");
    }

    #[test]
    fn pictures_smaller_than_the_window_have_no_ssim() {
        let board = checker(10, 40, 0.2, 0.8);
        assert_eq!(
            ssim(Image::new(10, 40, &board), Image::new(10, 40, &board)),
            None
        );
    }
}
