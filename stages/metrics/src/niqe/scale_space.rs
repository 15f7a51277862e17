//! The two planes NIQE measures: contrast-normalised luma, and the luma at half size. Knows nothing
//! of blocks. Sums run in f64, planes are kept in f32, as in the reference.

use super::pristine::WINDOW;
use rayon::prelude::*;

/// A plane of `height * width` numbers.
pub(super) struct Plane {
    pub width: usize,
    pub values: Vec<f32>,
}

impl Plane {
    pub fn height(&self) -> usize {
        self.values.len() / self.width
    }

    /// Mean-subtracted contrast-normalised coefficients, `(x - mu) / (sigma + 1)` (Eq. 1), with the
    /// local mean and deviation under `window`; pixels beyond the border repeat the border's.
    pub fn normalized(&self, window: &[f64]) -> Plane {
        let squares = Plane {
            width: self.width,
            values: self.values.iter().map(|x| x * x).collect(),
        };
        let means = self.average(window);
        let square_means = squares.average(window);
        let coefficient = |((x, mu), square): ((&f32, &f32), &f32)| {
            // Rounding may leave a variance below 0; the reference takes its size too.
            (x - mu) / ((square - mu * mu).abs().sqrt() + 1.0)
        };
        let values = self
            .values
            .iter()
            .zip(&means)
            .zip(&square_means)
            .map(coefficient)
            .collect();
        Plane {
            width: self.width,
            values,
        }
    }

    /// The weighted mean around each pixel.
    fn average(&self, window: &[f64]) -> Vec<f32> {
        let width = self.width;
        let height = self.height();
        let clamped = |at: usize, offset: usize, length: usize| {
            (at + offset).saturating_sub(WINDOW / 2).min(length - 1)
        };
        let mean = |x: usize, y: usize| -> f32 {
            let row = |j: usize| &self.values[clamped(y, j, height) * width..][..width];
            let row_sum = |j: usize| -> f64 {
                (0..WINDOW)
                    .map(|i| window[j * WINDOW + i] * f64::from(row(j)[clamped(x, i, width)]))
                    .sum()
            };
            // Rounded to f32: in f64 flat areas keep a texture of 1e-16, which swamps the rest.
            (0..WINDOW).map(row_sum).sum::<f64>() as f32
        };
        (0..width * height)
            .into_par_iter()
            .map(|at| mean(at % width, at / width))
            .collect()
    }

    /// The plane at half size as MATLAB's `imresize(x / 255, 0.5) * 255`: bicubic of a = -0.5,
    /// antialiased, borders mirrored. Both sides must be even and at least 4.
    pub fn halved(&self) -> Plane {
        // Divided and multiplied as in the reference: both roundings are part of its result.
        let unit: Vec<f32> = self.values.iter().map(|x| x / 255.0).collect();
        // Height before width, as the reference has it: what lies between is rounded to f32.
        let rows = halve_columns(&unit, self.width);
        let values = halve_rows(&rows, self.width)
            .into_iter()
            .map(|x| x * 255.0)
            .collect();
        Plane {
            width: self.width / 2,
            values,
        }
    }
}

/// The bicubic kernel of a = -0.5 stretched to twice its width, at distances 3.5, 2.5, 1.5 and 0.5;
/// and mirrored.
const HALVING: [f64; 8] = [
    -0.01171875,
    -0.03515625,
    0.11328125,
    0.43359375,
    0.43359375,
    0.11328125,
    -0.03515625,
    -0.01171875,
];

/// Halves the height: output row i weighs input rows 2i - 3 to 2i + 4.
fn halve_columns(values: &[f32], width: usize) -> Vec<f32> {
    let height = values.len() / width;
    let tap = |y: usize, x: usize, k: usize| {
        HALVING[k] * f64::from(values[mirrored(2 * y + k, height) * width + x])
    };
    let sum = |at: usize| (0..8).map(|k| tap(at / width, at % width, k)).sum::<f64>() as f32;
    (0..height / 2 * width).into_par_iter().map(sum).collect()
}

/// Halves the width in the same way.
fn halve_rows(values: &[f32], width: usize) -> Vec<f32> {
    let halve = |row: &[f32], x: usize| -> f32 {
        (0..8)
            .map(|k| HALVING[k] * f64::from(row[mirrored(2 * x + k, width)]))
            .sum::<f64>() as f32
    };
    values
        .par_chunks(width)
        .flat_map_iter(|row| (0..width / 2).map(move |x| halve(row, x)))
        .collect()
}

/// Index `shifted - 3` on a line of `length`, mirrored at the ends with the end pixel repeated.
fn mirrored(shifted: usize, length: usize) -> usize {
    match shifted.checked_sub(3) {
        None => 2 - shifted,
        Some(index) if index < length => index,
        Some(index) => 2 * length - 1 - index,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_keeps_a_ramp_away_from_the_borders() {
        let plane = Plane {
            width: 16,
            values: (0..256).map(|i| (i % 16) as f32).collect(),
        };
        let half = plane.halved();
        assert_eq!((half.width, half.height()), (8, 8));
        for x in 2..6 {
            assert!(
                (half.values[3 * 8 + x] - (2.0 * x as f32 + 0.5)).abs() < 1e-5,
                "{}",
                half.values[3 * 8 + x]
            );
        }
    }

    #[test]
    fn mirroring_repeats_the_end_pixel() {
        let line: Vec<usize> = (0..12).map(|shifted| mirrored(shifted, 5)).collect();
        assert_eq!(line, [2, 1, 0, 0, 1, 2, 3, 4, 4, 3, 2, 1]);
    }

    /// Single precision matters here: in double, the window's weights sum to one only up to
    /// rounding, and flat areas would gain a texture of 1e-16 whose statistics swamp the rest.
    #[test]
    fn a_flat_plane_normalises_to_exact_zeros() {
        let window = super::super::pristine::Pristine::read().window;
        let plane = Plane {
            width: 9,
            values: vec![173.0; 81],
        };
        assert!(plane.normalized(&window).values.iter().all(|&x| x == 0.0));
    }
}
