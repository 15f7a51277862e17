//! An image at the exposure of another, by least squares. Knows nothing of how either came about.

use crate::Image;

/// `image` with a gain and an offset per channel, chosen so that the squared error to `truth` is
/// the least over the pixels that `counts` (all, where it is `None`), and cut to 0..1. Both in sRGB
/// values, interleaved; a gain in linear light is such a map but for the darkest values.
///
/// # Panics
/// If the images differ in size.
pub fn exposed(image: Image<'_>, truth: Image<'_>, counts: Option<&[bool]>) -> Vec<f32> {
    assert_eq!(
        (image.width(), image.height()),
        (truth.width(), truth.height()),
        "exposed: images of two sizes"
    );
    let maps = [0, 1, 2].map(|channel| {
        let pairs = image.clamped().zip(truth.clamped()).enumerate();
        let own =
            pairs.filter(|(i, _)| i % 3 == channel && counts.is_none_or(|counts| counts[i / 3]));
        line(own.map(|(_, (a, b))| [a, b].map(f64::from)))
    });
    let at = |(i, value): (usize, f32)| {
        let [gain, offset] = maps[i % 3];
        (gain * f64::from(value) + offset).clamp(0.0, 1.0) as f32
    };
    image.clamped().enumerate().map(at).collect()
}

/// Gain and offset of the line through pairs of values; a gain of 1 where all first values are the
/// same.
fn line(pairs: impl Iterator<Item = [f64; 2]>) -> [f64; 2] {
    // Sums of f64, since the normal equations subtract nearly equal numbers.
    let mut sums = [0.0; 5];
    for [a, b] in pairs {
        let terms = [1.0, a, b, a * a, a * b];
        sums.iter_mut()
            .zip(terms)
            .for_each(|(sum, term)| *sum += term);
    }
    let [count, a, b, aa, ab] = sums;
    // The variance times the count's square, and so is the bound: a flat image has no gain to fit.
    let spread = count * aa - a * a;
    let gain = if spread > 1e-9 * count * count {
        (count * ab - a * b) / spread
    } else {
        1.0
    };
    // Where no pixel counts all sums are 0, and the map is the identity.
    [gain, (b - gain * a) / count.max(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_that_only_differs_in_exposure_becomes_the_other() {
        let truth: Vec<f32> = (0..60).map(|i| 0.2 + 0.01 * i as f32).collect();
        let image: Vec<f32> = truth.iter().map(|x| 0.7 * x + 0.1).collect();
        let [image, truth] = [&image, &truth].map(|rgb| Image::new(5, 4, rgb));
        let got = exposed(image, truth, None);
        let off = got.iter().zip(truth.clamped()).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f32::max) < 1e-5);
    }

    #[test]
    fn masked_pixels_have_no_say_and_flat_images_only_move() {
        let image = [0.5; 6];
        let truth = [0.6, 0.6, 0.6, 0.0, 0.0, 0.0];
        let [image, truth] = [&image, &truth].map(|rgb| Image::new(2, 1, rgb));
        let got = exposed(image, truth, Some(&[true, false]));
        assert!(got.iter().all(|x| (x - 0.6).abs() < 1e-6), "{got:?}");
        let none = exposed(image, truth, Some(&[false, false]));
        assert_eq!(none, [0.5; 6], "nothing to go by");
    }
}
