//! A picture as the metrics see it: borrowed, sRGB-encoded. Knows nothing of files or colour
//! management.

/// A picture of `height * width * 3` sRGB-encoded numbers, rows from the top, channels interleaved.
///
/// The nominal range is 0 to 1. Every metric clamps what lies outside, as an 8-bit file would; NaN
/// counts as 0.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    width: usize,
    height: usize,
    rgb: &'a [f32],
}

impl<'a> Image<'a> {
    /// A view of `rgb`. Panics if its length is not `height * width * 3`, or the picture is empty.
    pub fn new(width: usize, height: usize, rgb: &'a [f32]) -> Image<'a> {
        assert!(
            width > 0 && height > 0,
            "Image::new: {width}x{height} has no pixels"
        );
        assert_eq!(
            rgb.len(),
            width * height * 3,
            "Image::new: {} numbers for {width}x{height}x3",
            rgb.len()
        );
        Image { width, height, rgb }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The colour at column `x`, row `y`, clamped to 0..1.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        let at = (y * self.width + x) * 3;
        [
            unit(self.rgb[at]),
            unit(self.rgb[at + 1]),
            unit(self.rgb[at + 2]),
        ]
    }

    /// All numbers, interleaved, clamped to 0..1.
    pub fn clamped(&self) -> impl Iterator<Item = f32> + 'a {
        self.rgb.iter().copied().map(unit)
    }

    /// One channel as a plane of `height * width` numbers, clamped to 0..1.
    pub fn channel(&self, channel: usize) -> Vec<f64> {
        self.clamped()
            .skip(channel)
            .step_by(3)
            // SSIM subtracts nearly equal means of these, which takes more digits than f32 has.
            .map(f64::from)
            .collect()
    }

    /// Panics unless `other` has the same size: comparing different sizes is a programmer's error.
    pub(crate) fn assert_same_size(&self, other: &Image, metric: &str) {
        let a = (self.width, self.height);
        let b = (other.width, other.height);
        assert_eq!(a, b, "{metric}: pictures of different sizes");
    }
}

/// Clamps to 0..1; a NaN is not above 0 and so becomes 0.
fn unit(value: f32) -> f32 {
    if value > 0.0 { value.min(1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_outside_the_range_count_as_an_8_bit_file_would_store_them() {
        let rgb = [-0.5, 0.25, 7.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
        let image = Image::new(2, 1, &rgb);
        assert_eq!(image.pixel(0, 0), [0.0, 0.25, 1.0]);
        assert_eq!(image.pixel(1, 0), [0.0, 1.0, 0.0]);
        assert_eq!(image.channel(1), [0.25, 1.0]);
    }

    #[test]
    #[should_panic(expected = "Image::new: 5 numbers for 2x1x3")]
    fn a_slice_of_the_wrong_length_is_refused() {
        Image::new(2, 1, &[0.0; 5]);
    }
}
