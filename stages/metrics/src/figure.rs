//! Comparison pictures: the same view from several methods side by side, and magnified crops below
//! each. Knows nothing of files: it returns RGB8, and the caller writes it.

mod canvas;
mod detail;
mod font;

use crate::Image;
use canvas::{Canvas, Colour, Rect, TEXT_HEIGHT, text_width};

const MARGIN: usize = 24;
/// Pixels between panels.
const GUTTER: usize = 20;
/// Between the lines of a panel: text, picture, crops; and between crops.
const GAP: usize = 8;
/// Crops show each pixel four times as wide, unfiltered.
const ZOOM: usize = 4;
/// Wider pictures are reduced by a whole factor, narrower ones enlarged, to come within these
/// widths.
const PANEL_WIDTHS: std::ops::RangeInclusive<usize> = 256..=640;

const PAPER: Colour = [255, 255, 255];
const INK: Colour = [28, 30, 34];
const FAINT: Colour = [112, 117, 125];
/// Orange and sky blue of Okabe and Ito, told apart with any colour vision.
// One colour a crop, the same in all panels, so that a frame leads to its crop.
const CROPS: [Colour; 2] = [[230, 159, 0], [86, 180, 233]];

/// One column of a comparison.
#[derive(Clone, Copy)]
pub struct Panel<'a> {
    /// What is shown, as `bicubic`; printable ASCII.
    pub label: &'a str,
    /// A figure set beside the label, as `21.40 dB`; may be empty.
    pub note: &'a str,
    /// The picture at its own size; drawing brings it to a width that is pleasant to look at.
    pub image: Image<'a>,
}

/// A finished picture: `height * width * 3` sRGB bytes, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Pixels in a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// `height * width * 3` sRGB bytes, red, green and blue of each pixel together.
    pub rgb8: Vec<u8>,
}

/// Draws the panels from left to right, each with its label, its picture and two crops magnified
/// four times.
///
/// One crop lies where the first panel, by custom the truth, has most detail; the other where the
/// last panel has gained most on the second. They are at the same places in every panel and outlined
/// in its picture. Colours are clamped to 0..1 and shown as they are
/// (sRGB). Panics without panels, or if their sizes differ.
pub fn comparison(panels: &[Panel]) -> Figure {
    let [truth, ..] = panels else {
        panic!("comparison: no panels")
    };
    panels
        .iter()
        .for_each(|panel| truth.image.assert_same_size(&panel.image, "comparison"));
    let layout = Layout::of(panels, truth.image);
    let mut canvas = Canvas::new(
        layout.panel_left(panels.len()) - GUTTER + MARGIN,
        layout.height,
        PAPER,
    );
    for (index, panel) in panels.iter().enumerate() {
        layout.draw(&mut canvas, panel, layout.panel_left(index));
    }
    Figure {
        width: canvas.width,
        height: canvas.height,
        rgb8: canvas.rgb8,
    }
}

/// How a picture is brought to a width that is pleasant to look at.
#[derive(Clone, Copy)]
enum Overview {
    Enlarged(usize),
    Reduced(usize),
}

impl Overview {
    fn of(width: usize) -> Overview {
        match width {
            // Whole factors keep every pixel a square of one size.
            narrow if narrow < *PANEL_WIDTHS.start() => {
                Overview::Enlarged(PANEL_WIDTHS.start().div_ceil(narrow))
            }
            wide => Overview::Reduced(wide.div_ceil(*PANEL_WIDTHS.end())),
        }
    }

    /// A length in the picture as a length on the canvas, rounded up.
    fn length(self, pixels: usize) -> usize {
        match self {
            Overview::Enlarged(factor) => pixels * factor,
            Overview::Reduced(divisor) => pixels.div_ceil(divisor),
        }
    }

    fn draw(self, canvas: &mut Canvas, left: usize, top: usize, image: Image) {
        match self {
            Overview::Enlarged(factor) => canvas.enlarged(left, top, image, whole(image), factor),
            Overview::Reduced(divisor) => canvas.reduced(left, top, image, divisor),
        }
    }

    /// The outline of a crop in a picture drawn at (`left`, `top`).
    fn outline(self, crop: Rect, left: usize, top: usize) -> Rect {
        let place = |at: usize| match self {
            Overview::Enlarged(factor) => at * factor,
            Overview::Reduced(divisor) => at / divisor,
        };
        let width = self.length(crop.width);
        let height = self.length(crop.height);
        Rect {
            left: left + place(crop.left),
            top: top + place(crop.top),
            width,
            height,
        }
    }
}

fn whole(image: Image) -> Rect {
    Rect {
        left: 0,
        top: 0,
        width: image.width(),
        height: image.height(),
    }
}

/// Where everything goes; the same for all panels.
struct Layout {
    overview: Overview,
    panel_width: usize,
    /// Whether notes stand under the labels, for want of room beside them.
    notes_below: bool,
    picture_top: usize,
    crops_top: usize,
    crops: [Rect; 2],
    height: usize,
}

impl Layout {
    fn of(panels: &[Panel], truth: Image) -> Layout {
        let overview = Overview::of(truth.width());
        let panel_width = overview.length(truth.width());
        let crowded =
            |panel: &Panel| text_width(panel.label) + GUTTER + text_width(panel.note) > panel_width;
        let notes_below = panels
            .iter()
            .any(|panel| !panel.note.is_empty() && crowded(panel));
        let lines = if notes_below { 2 } else { 1 };
        let picture_top = MARGIN + lines * (TEXT_HEIGHT + GAP / 2);
        let crops_top = picture_top + overview.length(truth.height()) + GAP;
        let side = (panel_width - GAP) / 2 / ZOOM;
        let images: Vec<_> = panels.iter().map(|panel| panel.image).collect();
        let crops =
            // A crop can be no larger than the picture.
            detail::worth_a_look(&images, side.min(truth.width()), side.min(truth.height()));
        let height = crops_top + crops[0].height * ZOOM + MARGIN;
        Layout {
            overview,
            panel_width,
            notes_below,
            picture_top,
            crops_top,
            crops,
            height,
        }
    }

    fn panel_left(&self, index: usize) -> usize {
        MARGIN + index * (self.panel_width + GUTTER)
    }

    fn draw(&self, canvas: &mut Canvas, panel: &Panel, left: usize) {
        self.draw_text(canvas, panel, left);
        self.overview
            .draw(canvas, left, self.picture_top, panel.image);
        for (index, (crop, colour)) in self.crops.into_iter().zip(CROPS).enumerate() {
            // After the picture, which would cover it.
            canvas.frame(
                self.overview.outline(crop, left, self.picture_top),
                2,
                colour,
            );
            let width = crop.width * ZOOM;
            let height = crop.height * ZOOM;
            // The second crop ends at the panel's right edge.
            let left = left + index * (self.panel_width - width);
            canvas.enlarged(left, self.crops_top, panel.image, crop, ZOOM);
            canvas.frame(
                Rect {
                    left,
                    top: self.crops_top,
                    width,
                    height,
                },
                3,
                colour,
            );
        }
    }

    fn draw_text(&self, canvas: &mut Canvas, panel: &Panel, left: usize) {
        canvas.text(left, MARGIN, self.panel_width, panel.label, INK);
        let (left, top) = match self.notes_below {
            true => (left, MARGIN + TEXT_HEIGHT + GAP / 2),
            false => (
                (left + self.panel_width).saturating_sub(text_width(panel.note)),
                MARGIN,
            ),
        };
        canvas.text(left, top, self.panel_width, panel.note, FAINT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Vec<f32> {
        (0..width * height * 3)
            .map(|i| (i * 31 % 97) as f32 / 97.0)
            .collect()
    }

    fn panel<'a>(label: &'a str, width: usize, height: usize, rgb: &'a [f32]) -> Panel<'a> {
        Panel {
            label,
            note: "20.00 dB",
            image: Image::new(width, height, rgb),
        }
    }

    #[test]
    fn a_figure_holds_its_panels_and_is_the_same_every_time() {
        let rgb = picture(400, 300);
        let panels = [
            panel("truth", 400, 300, &rgb),
            panel("bicubic", 400, 300, &rgb),
        ];
        let figure = comparison(&panels);
        assert_eq!(figure.width, 24 + 400 + 20 + 400 + 24);
        assert_eq!(figure.height, 24 + 31 + 300 + 8 + 49 * 4 + 24);
        assert_eq!(figure.rgb8.len(), figure.width * figure.height * 3);
        assert_eq!(comparison(&panels), figure);
    }

    #[test]
    fn pictures_of_any_size_find_room() {
        for (width, height, figure_width) in [
            (1, 1, 304),
            (16, 200, 304),
            (2016, 3, 24 + 504 + 24),
            (641, 2, 369),
        ] {
            let rgb = picture(width, height);
            assert_eq!(
                comparison(&[panel("ours", width, height, &rgb)]).width,
                figure_width,
                "{width}x{height}"
            );
        }
    }

    #[test]
    fn long_labels_push_the_notes_to_a_line_of_their_own() {
        let rgb = picture(256, 64);
        let label = "a label that leaves no room beside";
        let plain = comparison(&[panel("short", 256, 64, &rgb)]);
        assert_eq!(
            comparison(&[panel(label, 256, 64, &rgb)]).height,
            plain.height + 31
        );
    }
}
