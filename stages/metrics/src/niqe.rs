//! The natural image quality evaluator: how far a picture's local statistics are from those of
//! undistorted photos (Mittal, Soundararajan, Bovik 2013). Follows BasicSR's port of the LIVE
//! release step by step, its single-precision intermediate pictures included, because flat regions
//! depend on them. Knows no reference picture.

mod aggd;
mod features;
mod pristine;
mod scale_space;

use crate::{Image, eigen};
use features::{BLOCK, Features};
use pristine::{FEATURES, Pristine};

/// What NIQE says of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Niqe {
    /// The distance to the statistics of undistorted photos, from 0; lower is better, photos lie
    /// around 2 to 6.
    pub value: f64,
    /// The 96x96 blocks whose statistics were fitted.
    pub blocks: usize,
}

impl Niqe {
    /// Whether the blocks are too few (36 or less) for a covariance of full rank. The value still
    /// comes out, since it is averaged with the pristine covariance, but it leans on the latter and
    /// scatters: warn when reporting it.
    pub fn rank_deficient(&self) -> bool {
        self.blocks <= FEATURES
    }
}

/// NIQE of the BT.601 luma (studio swing, rounded to integers) of an sRGB picture clamped to 0..1;
/// no border crop.
///
/// Only whole 96x96 blocks from the top left count. `None` if the picture holds fewer than two
/// blocks with texture: anything below 96x192, and pictures without contrast. Depends on
/// resolution, so compare pictures of one size only. Not the number of MATLAB's `niqe` nor of
/// gray-scale variants (`docs/metrics.md`).
pub fn niqe(image: Image) -> Option<Niqe> {
    let columns = image.width() / BLOCK;
    let rows = image.height() / BLOCK;
    if columns * rows < 2 {
        return None;
    }
    // Cut to whole blocks first: halving and local means see borders where the blocks end.
    let features = features::of_blocks(luma(image, columns * BLOCK, rows * BLOCK), columns, rows);
    let complete: Vec<Features> = features
        .iter()
        .filter(|row| row.iter().all(|v| v.is_finite()))
        .copied()
        .collect();
    let value = distance(&Pristine::read(), &mean_of_numbers(&features), &complete)?;
    Some(Niqe {
        value,
        blocks: complete.len(),
    })
}

/// The top left `width * height` pixels as BT.601 luma in 16..235, rounded half to even, as
/// BasicSR's chain of single and double precision gives it.
fn luma(image: Image, width: usize, height: usize) -> Vec<f32> {
    let y = |[r, g, b]: [f32; 3]| {
        // The weights add up to 219, the swing from 16 to 235.
        let luma = 65.481 * f64::from(r) + 128.553 * f64::from(g) + 24.966 * f64::from(b) + 16.0;
        ((luma / 255.0) as f32 * 255.0).round_ties_even()
    };
    (0..height)
        .flat_map(|row| (0..width).map(move |column| y(image.pixel(column, row))))
        .collect()
}

/// `sqrt(d^T pinv((C_pristine + C) / 2) d)` with d the difference of the means (Eq. 10). The mean
/// takes every finite feature, the covariance only the blocks where all are; fewer than two of
/// these fit no distribution.
fn distance(pristine: &Pristine, mean: &Features, complete: &[Features]) -> Option<f64> {
    if complete.len() < 2 {
        return None;
    }
    let own = covariance(complete);
    let average = |i: usize, j: usize| 0.5 * (pristine.covariance[i][j] + own[i][j]);
    let average = (0..FEATURES)
        .map(|i| (0..FEATURES).map(|j| average(i, j)).collect())
        .collect();
    let difference: Vec<f64> = (0..FEATURES).map(|i| pristine.mean[i] - mean[i]).collect();
    // A pseudo-inverse, as in BasicSR: few blocks may leave directions without variance.
    let value = eigen::pinv_quadratic_form(average, &difference).sqrt();
    // Rounding can bring the form below 0, and its root is NaN.
    value.is_finite().then_some(value)
}

/// The mean of each feature over the blocks where it is a number.
fn mean_of_numbers(features: &[Features]) -> Features {
    std::array::from_fn(|i| {
        let numbers = || features.iter().map(|row| row[i]).filter(|v| !v.is_nan());
        numbers().sum::<f64>() / numbers().count() as f64
    })
}

/// The sample covariance (n - 1) of the rows.
fn covariance(rows: &[Features]) -> Vec<Vec<f64>> {
    let mean = mean_of_numbers(rows);
    let entry = |i: usize, j: usize| -> f64 {
        let products = rows
            .iter()
            .map(|row| (row[i] - mean[i]) * (row[j] - mean[j]));
        // Divided by n - 1, as numpy's `cov` does by default.
        products.sum::<f64>() / (rows.len() - 1) as f64
    };
    (0..FEATURES)
        .map(|i| (0..FEATURES).map(|j| entry(i, j)).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: usize, height: usize) -> Vec<f32> {
        (0..width * height * 3)
            .map(|i| (i / 3 * 7919 % 251) as f32 / 251.0)
            .collect()
    }

    #[test]
    fn below_two_blocks_there_is_no_niqe() {
        let rgb = texture(191, 191);
        assert_eq!(niqe(Image::new(191, 191, &rgb)), None);
        let rgb = texture(96, 192);
        let niqe = niqe(Image::new(96, 192, &rgb)).unwrap();
        assert!(
            niqe.value > 0.0 && niqe.blocks == 2 && niqe.rank_deficient(),
            "{niqe:?}"
        );
    }

    #[test]
    fn a_picture_without_contrast_has_no_niqe() {
        assert_eq!(niqe(Image::new(288, 288, &vec![0.7; 288 * 288 * 3])), None);
    }

    #[test]
    fn luma_runs_from_16_to_235_in_whole_numbers() {
        let rgb = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.1, 0.9];
        assert_eq!(luma(Image::new(3, 1, &rgb), 3, 1), [16.0, 235.0, 84.0]);
    }
}
