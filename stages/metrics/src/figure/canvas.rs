//! An RGB8 picture to draw on. Knows rectangles, pictures and text, nothing of layout.

use super::font;
use crate::Image;

/// Pixels per unit square of the font.
const TEXT_SCALE: usize = 3;
/// The height of a line of text.
pub(super) const TEXT_HEIGHT: usize = font::GLYPH_ROWS * TEXT_SCALE;

/// Red, green and blue, sRGB-encoded.
pub(super) type Colour = [u8; 3];

/// Column, row, width and height, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rect {
    pub left: usize,
    pub top: usize,
    pub width: usize,
    pub height: usize,
}

/// The columns that a line of text takes.
pub(super) fn text_width(text: &str) -> usize {
    font::width(text) * TEXT_SCALE
}

/// A picture under way; what is drawn beyond its edges is dropped.
pub(super) struct Canvas {
    pub width: usize,
    pub height: usize,
    pub rgb8: Vec<u8>,
}

impl Canvas {
    /// A canvas of one colour.
    pub fn new(width: usize, height: usize, colour: Colour) -> Canvas {
        Canvas {
            width,
            height,
            rgb8: colour.repeat(width * height),
        }
    }

    fn put(&mut self, x: usize, y: usize, colour: Colour) {
        if x < self.width && y < self.height {
            let at = (y * self.width + x) * 3;
            self.rgb8[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn fill(&mut self, rect: Rect, colour: Colour) {
        for y in rect.top..rect.top + rect.height {
            (rect.left..rect.left + rect.width).for_each(|x| self.put(x, y, colour));
        }
    }

    /// A frame of `thickness` just inside `rect`.
    pub fn frame(&mut self, rect: Rect, thickness: usize, colour: Colour) {
        let Rect {
            left,
            top,
            width,
            height,
        } = rect;
        // Added before it is subtracted: a crop may be lower than the frame is thick.
        let right = left + width - thickness;
        let bottom = top + height - thickness;
        self.fill(
            Rect {
                height: thickness,
                ..rect
            },
            colour,
        );
        self.fill(
            Rect {
                top: bottom,
                height: thickness,
                ..rect
            },
            colour,
        );
        self.fill(
            Rect {
                left,
                top,
                width: thickness,
                height,
            },
            colour,
        );
        self.fill(
            Rect {
                left: right,
                top,
                width: thickness,
                height,
            },
            colour,
        );
    }

    /// Text from `left`, its cap line at `top`; glyphs' parts beyond `limit` columns are left out.
    pub fn text(&mut self, left: usize, top: usize, limit: usize, text: &str, colour: Colour) {
        for (x, y) in font::ink(text)
            .into_iter()
            .filter(|(x, _)| (x + 1) * TEXT_SCALE <= limit)
        {
            let left = left + x * TEXT_SCALE;
            let top = top + y * TEXT_SCALE;
            self.fill(
                Rect {
                    left,
                    top,
                    width: TEXT_SCALE,
                    height: TEXT_SCALE,
                },
                colour,
            );
        }
    }

    /// The part `source` of `image` at (`left`, `top`), each pixel `factor` wide.
    pub fn enlarged(&mut self, left: usize, top: usize, image: Image, source: Rect, factor: usize) {
        for y in 0..source.height {
            for x in 0..source.width {
                let colour = image.pixel(source.left + x, source.top + y).map(to_8_bit);
                let left = left + x * factor;
                let top = top + y * factor;
                self.fill(
                    Rect {
                        left,
                        top,
                        width: factor,
                        height: factor,
                    },
                    colour,
                );
            }
        }
    }

    /// The whole `image` at (`left`, `top`), every `divisor * divisor` pixels averaged into one.
    pub fn reduced(&mut self, left: usize, top: usize, image: Image, divisor: usize) {
        for y in 0..image.height().div_ceil(divisor) {
            for x in 0..image.width().div_ceil(divisor) {
                self.put(
                    left + x,
                    top + y,
                    mean(image, x * divisor, y * divisor, divisor).map(to_8_bit),
                );
            }
        }
    }
}

/// The mean colour of the square of `side` at (`left`, `top`), as far as it lies in the image.
fn mean(image: Image, left: usize, top: usize, side: usize) -> [f32; 3] {
    let right = (left + side).min(image.width());
    let bottom = (top + side).min(image.height());
    let mut sum = [0.0; 3];
    for (y, x) in (top..bottom).flat_map(|y| (left..right).map(move |x| (y, x))) {
        let pixel = image.pixel(x, y);
        sum = std::array::from_fn(|c| sum[c] + pixel[c]);
    }
    sum.map(|s| s / ((right - left) * (bottom - top)) as f32)
}

fn to_8_bit(value: f32) -> u8 {
    (value * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reds(canvas: &Canvas) -> Vec<&[u8]> {
        let reds: &[u8] = &canvas.rgb8;
        reds.chunks(canvas.width * 3).collect()
    }

    #[test]
    fn a_frame_lies_just_inside_its_rectangle() {
        let mut canvas = Canvas::new(5, 4, [0; 3]);
        canvas.frame(
            Rect {
                left: 1,
                top: 0,
                width: 4,
                height: 4,
            },
            1,
            [9; 3],
        );
        let row = |marks: &[u8]| marks.iter().flat_map(|&m| [m; 3]).collect::<Vec<u8>>();
        assert_eq!(reds(&canvas)[0], row(&[0, 9, 9, 9, 9]));
        assert_eq!(reds(&canvas)[1], row(&[0, 9, 0, 0, 9]));
        assert_eq!(reds(&canvas)[3], row(&[0, 9, 9, 9, 9]));
    }

    #[test]
    fn pictures_are_enlarged_by_repeating_and_reduced_by_averaging() {
        let rgb = [0.0, 0.0, 0.0, 0.2, 0.2, 0.2, 1.0, 1.0, 1.0];
        let image = Image::new(3, 1, &rgb);
        let mut canvas = Canvas::new(4, 3, [7; 3]);
        canvas.enlarged(
            0,
            0,
            image,
            Rect {
                left: 1,
                top: 0,
                width: 2,
                height: 1,
            },
            2,
        );
        canvas.reduced(0, 2, image, 2);
        let reds: Vec<u8> = canvas.rgb8.iter().step_by(3).copied().collect();
        assert_eq!(reds, [51, 51, 255, 255, 51, 51, 255, 255, 26, 255, 7, 7]);
    }

    #[test]
    fn drawing_beyond_the_edges_is_dropped() {
        let mut canvas = Canvas::new(3, 3, [1; 3]);
        canvas.text(2, 0, usize::MAX, "HHH", [1; 3]);
        canvas.frame(
            Rect {
                left: 2,
                top: 2,
                width: 5,
                height: 5,
            },
            1,
            [2; 3],
        );
        assert_eq!(
            canvas.rgb8.iter().map(|&v| u32::from(v)).sum::<u32>(),
            27 + 3
        );
    }
}
