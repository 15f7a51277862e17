//! The statistics of undistorted photos that NIQE measures against, read from
//! `params/niqe_pristine.f64le` (whose origin and licences stand in `NOTICE`). Knows nothing of
//! pictures.

/// Features of a block: 18 at each of two scales.
pub(super) const FEATURES: usize = 36;
/// The side of the Gaussian window for local means.
pub(super) const WINDOW: usize = 7;

/// 36 means, 36x36 covariances and 7x7 window weights, little-endian f64, rows first.
// The length is part of the type: a file of another size does not compile.
const BYTES: &[u8; (FEATURES + FEATURES * FEATURES + WINDOW * WINDOW) * 8] =
    include_bytes!("../../params/niqe_pristine.f64le");

/// The multivariate Gaussian of undistorted photos, and the window its features were measured with.
pub(super) struct Pristine {
    pub mean: Vec<f64>,
    pub covariance: Vec<Vec<f64>>,
    /// Weights of sum one, rows first; a Gaussian of standard deviation 7/6.
    pub window: Vec<f64>,
}

impl Pristine {
    pub fn read() -> Pristine {
        let numbers: Vec<f64> = BYTES
            .as_chunks()
            .0
            .iter()
            .map(|bytes| f64::from_le_bytes(*bytes))
            .collect();
        let (mean, rest) = numbers.split_at(FEATURES);
        // The window is stored too, so that its last bits are the reference's.
        let (covariance, window) = rest.split_at(FEATURES * FEATURES);
        let covariance = covariance.chunks(FEATURES).map(<[f64]>::to_vec).collect();
        Pristine {
            mean: mean.to_vec(),
            covariance,
            window: window.to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_holds_a_gaussian_window_and_a_symmetric_covariance() {
        let Pristine {
            covariance, window, ..
        } = Pristine::read();
        let weight = |x: usize, y: usize| {
            (-0.5 * ((x as f64 - 3.0).powi(2) + (y as f64 - 3.0).powi(2)) * 36.0 / 49.0).exp()
        };
        let sum: f64 = (0..49).map(|i| weight(i % 7, i / 7)).sum();
        assert!((0..49).all(|i| (window[i] - weight(i % 7, i / 7) / sum).abs() < 1e-12));
        assert!((0..36).all(
            |i| covariance[i][i] > 0.0 && (0..i).all(|j| covariance[i][j] == covariance[j][i])
        ));
    }
}
