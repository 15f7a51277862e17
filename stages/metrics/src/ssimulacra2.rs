//! SSIMULACRA2 (Sneyers 2022, <https://github.com/cloudinary/ssimulacra2>): structural similarity
//! at six scales in a colour space of the eye, weighted to agree with people's judgements of
//! compressed photos. The computing is the crate `ssimulacra2`'s; this file says for which pictures
//! it has a meaning.

use ssimulacra2::{
    ColorPrimaries, Rgb, TransferCharacteristic, compute_frame_ssimulacra2 as compute,
};

use crate::Image;

/// The least side of a picture that has all six scales: each is half as large as the one before,
/// and must have 8 pixels before it is halved.
const LEAST_SIDE: usize = 113;

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
    // The truth goes first: the score is not symmetric, and the crate takes the source first.
    compute(frame(truth)?, frame(image)?).ok()
}

fn frame(image: Image) -> Option<Rgb> {
    let width = image.width();
    let height = image.height();
    let pixels = (0..width * height).map(|at| image.pixel(at % width, at / width));
    Rgb::new(
        pixels.collect(),
        width,
        height,
        // The numbers are encoded; the crate undoes this curve before it blurs.
        TransferCharacteristic::SRGB,
        ColorPrimaries::BT709,
    )
    .ok()
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
}
