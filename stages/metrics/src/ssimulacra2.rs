//! SSIMULACRA2 2.1 (Sneyers 2022, <https://github.com/cloudinary/ssimulacra2>): structural similarity
//! at six scales in a colour space of the eye, weighted to agree with people's judgements of
//! compressed photos. Knows nothing of what pictures show.
//!
//! In double precision throughout. Variances are differences of large, nearly equal numbers where a
//! picture is flat, and in single precision such places (an object before white) move the score by
//! a quarter of a point.

mod weights;

use std::array;

use rayon::prelude::*;

use self::weights::WEIGHTS;
use crate::Image;

/// The least side of a picture that has all six scales: each is half as large as the one before,
/// and must have 8 pixels before it is halved.
const LEAST_SIDE: usize = 113;
const SCALES: usize = 6;
/// The stabilising constant of SSIM's second factor.
const C2: f64 = 0.0009;
/// Half of the blur's taps, the middle first: a Gaussian of sigma 1.5 as a sum of three cosines,
/// which is 0 from five pixels on (Charalampidis 2016).
const TAPS: [f64; 5] = [
    0.264_621_105_488_198_4,
    0.212_928_592_010_422_05,
    0.109_335_372_777_460_14,
    0.036_011_114_658_364_2,
    0.009_414_367_809_653_51,
];

/// Linear sRGB to the absorbances of the eye's three cones.
const ABSORBANCE: [[f64; 3]; 3] = [
    [0.3, 0.622, 0.078],
    [0.23, 0.692, 0.078],
    [0.243_422_69, 0.204_767_45, 0.551_809_86],
];
const ABSORBANCE_BIAS: f64 = 0.003_793_073_4;

/// A picture or a plane of one, rows first.
struct Grid<T> {
    values: Vec<T>,
    width: usize,
}

/// SSIMULACRA2 of `image` against `truth`: 100 for identical pictures, 90 where nobody sees a
/// difference, 50 for a medium and 10 for a very low quality, and below 0 without end. Not
/// symmetric.
///
/// `None` if a side is below 113 pixels: the weights are those of six scales, and such a picture
/// has fewer. Panics if the sizes differ.
pub fn ssimulacra2(truth: Image, image: Image) -> Option<f64> {
    truth.assert_same_size(&image, "ssimulacra2");
    if truth.width().min(truth.height()) < LEAST_SIDE {
        return None;
    }
    let mut truth = linear(truth);
    let mut image = linear(image);
    let mut error = 0.0;
    for scale in 0..SCALES {
        if scale > 0 {
            truth = halved(&truth);
            image = halved(&image);
        }
        // Collected and then added in order: the same bits for any number of threads.
        let channels: Vec<[[f64; 3]; 2]> = (0..3)
            .into_par_iter()
            .map(|channel| errors(&plane(&truth, channel), &plane(&image, channel)))
            .collect();
        for (errors, weights) in channels.iter().zip(&WEIGHTS) {
            let errors = errors.as_flattened().iter();
            let weighted = errors.zip(weights[scale].as_flattened());
            error += weighted.map(|(error, weight)| error * weight).sum::<f64>();
        }
    }
    Some(score(error))
}

/// From the weighted sum of errors to the scale of people's judgements.
fn score(error: f64) -> f64 {
    let x = error * 0.956_238_261_683_484_4;
    let curve = 2.326_765_642_916_932 * x - 0.020_884_521_182_843_837 * x * x
        + 6.248_496_625_763_138e-5 * x * x * x;
    if curve <= 0.0 {
        return 100.0;
    }
    100.0 - 10.0 * curve.powf(0.627_633_646_783_138_7)
}

fn linear(image: Image) -> Grid<[f64; 3]> {
    let width = image.width();
    let pixels = (0..width * image.height()).into_par_iter();
    Grid {
        values: pixels
            .map(|i| image.pixel(i % width, i / width).map(decoded))
            .collect(),
        width,
    }
}

/// Linear light of an sRGB value.
fn decoded(value: f32) -> f64 {
    let value = f64::from(value);
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// Means over 2x2 pixels; the last column and row stand for those beyond.
fn halved(picture: &Grid<[f64; 3]>) -> Grid<[f64; 3]> {
    let width = picture.width;
    let height = picture.values.len() / width;
    let mean = |x: usize, y: usize| {
        let columns = [2 * x, (2 * x + 1).min(width - 1)];
        let rows = [2 * y, (2 * y + 1).min(height - 1)];
        array::from_fn(|channel| {
            let of = |row: usize| columns.map(|x| picture.values[row * width + x][channel]);
            rows.map(of).as_flattened().iter().sum::<f64>() / 4.0
        })
    };
    let half = width.div_ceil(2);
    Grid {
        values: (0..height.div_ceil(2))
            .flat_map(|y| (0..half).map(move |x| (x, y)))
            .map(|(x, y)| mean(x, y))
            .collect(),
        width: half,
    }
}

/// A channel of XYB (JPEG XL's colour space), shifted and stretched to positive numbers below 1.
fn plane(picture: &Grid<[f64; 3]>, channel: usize) -> Grid<f64> {
    let bias = ABSORBANCE_BIAS.cbrt();
    let seen = |rgb: &[f64; 3]| {
        let [long, medium, short] = ABSORBANCE.map(|row| {
            let light: f64 = row.iter().zip(rgb).map(|(a, b)| a * b).sum();
            (light + ABSORBANCE_BIAS).cbrt() - bias
        });
        let y = (long + medium) / 2.0;
        match channel {
            0 => (long - medium) / 2.0 * 14.0 + 0.42,
            1 => y + 0.01,
            _ => short - y + 0.55,
        }
    };
    Grid {
        values: picture.values.iter().map(seen).collect(),
        width: picture.width,
    }
}

/// Mean and 4-norm of the three errors of a plane, in the order of the weights.
fn errors(truth: &Grid<f64>, image: &Grid<f64>) -> [[f64; 3]; 2] {
    let blurred = |a: &Grid<f64>, b: &Grid<f64>| {
        let products = a.values.iter().zip(&b.values).map(|(a, b)| a * b);
        blur(products.collect(), a.width)
    };
    let mean_truth = blur(truth.values.clone(), truth.width);
    let mean_image = blur(image.values.clone(), image.width);
    let square_truth = blurred(truth, truth);
    let square_image = blurred(image, image);
    let product = blurred(truth, image);
    let mut sums = [[0.0; 3]; 2];
    for i in 0..truth.values.len() {
        let [a, b] = [mean_truth[i], mean_image[i]];
        // SSIM without the denominator of its first factor: values are as the eye has them, so an
        // error in the dark weighs no more.
        let same_mean = 1.0 - (a - b) * (a - b);
        let covariance = product[i] - a * b;
        let variances = (square_truth[i] - a * a) + (square_image[i] - b * b);
        let structure = 1.0 - same_mean * (2.0 * covariance + C2) / (variances + C2);
        let edge = (1.0 + (image.values[i] - b).abs()) / (1.0 + (truth.values[i] - a).abs()) - 1.0;
        let errors = [structure, edge, -edge].map(|error: f64| error.max(0.0));
        for (k, error) in errors.into_iter().enumerate() {
            sums[0][k] += error;
            sums[1][k] += error.powi(4);
        }
    }
    let count = truth.values.len() as f64;
    [
        sums[0].map(|sum| sum / count),
        sums[1].map(|sum| (sum / count).sqrt().sqrt()),
    ]
}

/// Blurs a plane; beyond its border there is 0, as in the reference.
fn blur(values: Vec<f64>, width: usize) -> Vec<f64> {
    let rows: Vec<f64> = values.chunks(width).flat_map(blurred_row).collect();
    let mut columns = vec![0.0; rows.len()];
    let height = rows.len() / width;
    for (y, out) in columns.chunks_mut(width).enumerate() {
        for (distance, tap) in TAPS.iter().enumerate() {
            let above = y.checked_sub(distance);
            let below = Some(y + distance).filter(|&y| y < height && distance > 0);
            for row in [above, below].into_iter().flatten() {
                let row = &rows[row * width..][..width];
                out.iter_mut().zip(row).for_each(|(out, x)| *out += tap * x);
            }
        }
    }
    columns
}

fn blurred_row(row: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; row.len()];
    for (distance, tap) in TAPS.iter().enumerate() {
        let inside = row.len().saturating_sub(distance);
        for x in 0..inside {
            out[x + distance] += tap * row[x];
            if distance > 0 {
                out[x] += tap * row[x + distance];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(side: usize) -> Vec<f32> {
        (0..side * side * 3)
            .map(|i| (i * 37 % 101) as f32 / 101.0)
            .collect()
    }

    #[test]
    fn identical_pictures_score_a_hundred_and_worse_ones_less() {
        let rgb = noise(128);
        let worse: Vec<f32> = rgb.iter().map(|value| value * 0.5).collect();
        let truth = Image::new(128, 128, &rgb);
        let worse = Image::new(128, 128, &worse);
        assert_eq!(ssimulacra2(truth, truth), Some(100.0));
        assert!(ssimulacra2(truth, worse).unwrap() < 60.0);
    }

    #[test]
    fn pictures_without_all_six_scales_have_no_score() {
        let rgb = noise(112);
        let small = Image::new(112, 112, &rgb);
        assert_eq!(ssimulacra2(small, small), None);
        let rgb = noise(113);
        let enough = Image::new(113, 113, &rgb);
        assert_eq!(ssimulacra2(enough, enough), Some(100.0));
    }

    #[test]
    fn a_lone_point_becomes_the_taps_and_what_passes_the_border_is_lost() {
        let mut point = vec![0.0; 12 * 11];
        point[5 * 12 + 1] = 1.0;
        let blurred = blur(point, 12);
        let row = &blurred[5 * 12..][..12];
        let expected = [1, 0, 1, 2, 3, 4].map(|distance| TAPS[0] * TAPS[distance]);
        assert_eq!(row[..6], expected);
        assert_eq!(row[6..], [0.0; 6]);
        let whole = TAPS[0] + 2.0 * TAPS[1..].iter().sum::<f64>();
        assert!((whole - 1.0).abs() < 1e-14);
    }
}
