//! The separable Gaussian average that SSIM takes. Knows nothing of colour or of what is averaged.

use rayon::prelude::*;

/// Taps on either side of the centre: the window is 11 wide.
pub(crate) const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;

/// Averages a plane of `height * width` under the window, where the whole window fits: the result
/// is `(height - 10) * (width - 10)`. Both sides must be at least 11.
pub(crate) fn average(plane: &[f64], width: usize) -> Vec<f64> {
    // A 2-D Gaussian is a product, so two passes of 11 taps replace one of 121.
    let window = window();
    let inner = width - 2 * RADIUS;
    let rows: Vec<f64> = plane
        .par_chunks(width)
        .flat_map_iter(|row| {
            (0..inner).map(move |x| (0..window.len()).map(|k| window[k] * row[x + k]).sum())
        })
        .collect();
    (0..rows.len() / inner - 2 * RADIUS)
        .into_par_iter()
        .flat_map_iter(|y| {
            let rows = &rows;
            (0..inner).map(move |x| {
                (0..window.len())
                    .map(|k| window[k] * rows[(y + k) * inner + x])
                    .sum()
            })
        })
        .collect()
}

/// The normalised taps `exp(-x^2 / 2 sigma^2)`.
fn window() -> [f64; 2 * RADIUS + 1] {
    let taps: [f64; 2 * RADIUS + 1] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = taps.iter().sum();
    // Weights of sum 1 leave a flat plane as it is, and its variance at 0.
    taps.map(|tap| tap / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_and_a_lone_point_becomes_the_window() {
        assert!(
            average(&[3.0; 12 * 13], 12)
                .iter()
                .all(|v| (v - 3.0).abs() < 1e-14)
        );
        let mut plane = vec![0.0; 11 * 13];
        plane[7 * 11 + 5] = 1.0;
        let centre = window()[RADIUS];
        let expected = [
            window()[7] * centre,
            window()[6] * centre,
            window()[5] * centre,
        ];
        assert_eq!(average(&plane, 11), expected);
    }
}
