//! Finds what of pictures is worth a look from near. Knows nothing of drawing.

use super::canvas::Rect;
use crate::Image;

/// Two windows of `width * height`, in the order of their columns: the one where the first picture,
/// the truth, has most detail, which is hard for all; and the one where the last picture is closer
/// to the truth than the second by most. Of two pictures or one: where the truth has most detail
/// beside the first window. Both sides must fit the pictures. The upper left window wins a tie.
pub(super) fn worth_a_look(images: &[Image], width: usize, height: usize) -> [Rect; 2] {
    let truth = images[0];
    let detail = gradients(truth);
    let first = best_window(&detail, truth.width(), width, height);
    let mut worth = match images {
        [truth, second, .., last] => gain(*truth, *second, *last),
        _ => detail,
    };
    // At 0 the first window's place wins again only where nothing else is worth a look.
    for y in first.top..first.top + height {
        worth[y * truth.width() + first.left..][..width].fill(0.0);
    }
    let second = best_window(&worth, truth.width(), width, height);
    // Crops stand in the order of their outlines above them.
    if second.left < first.left {
        [second, first]
    } else {
        [first, second]
    }
}

/// By how much less the square of the error of `last` is than that of `second`, per pixel.
fn gain(truth: Image, second: Image, last: Image) -> Vec<f64> {
    let mut gain = vec![0.0; truth.width() * truth.height()];
    for channel in 0..3 {
        let [truth, second, last] = [truth, second, last].map(|image| image.channel(channel));
        for (i, gain) in gain.iter_mut().enumerate() {
            *gain += (second[i] - truth[i]).powi(2) - (last[i] - truth[i]).powi(2);
        }
    }
    gain
}

/// `|dx| + |dy|` of the green channel per pixel, zero on the last column and row.
fn gradients(image: Image) -> Vec<f64> {
    let width = image.width();
    // Green stands for luminance, of which it is the largest part.
    let green = image.channel(1);
    let step = |at: usize, to: usize, inside: bool| {
        if inside {
            (green[to] - green[at]).abs()
        } else {
            0.0
        }
    };
    let gradient = |at: usize| {
        step(at, at + 1, at % width + 1 < width)
            + step(at, at + width, at / width + 1 < image.height())
    };
    (0..green.len()).map(gradient).collect()
}

/// The window with the largest sum.
fn best_window(detail: &[f64], image_width: usize, width: usize, height: usize) -> Rect {
    // Four look-ups a window whatever its size: windows of all places are tried.
    let table = summed_area(detail, image_width);
    let stride = image_width + 1;
    let sum = |x: usize, y: usize| {
        let top = y * stride + x;
        let bottom = (y + height) * stride + x;
        table[bottom + width] - table[bottom] - table[top + width] + table[top]
    };
    let mut best = (
        Rect {
            left: 0,
            top: 0,
            width,
            height,
        },
        f64::NEG_INFINITY,
    );
    for top in 0..=detail.len() / image_width - height {
        for left in 0..=image_width - width {
            let total = sum(left, top);
            // Strictly above, so that the upper left window wins a tie.
            if total > best.1 {
                best = (
                    Rect {
                        left,
                        top,
                        width,
                        height,
                    },
                    total,
                );
            }
        }
    }
    best.0
}

/// The summed-area table: entry (x, y) of `width + 1` columns is the sum of all left of x and above
/// y.
fn summed_area(values: &[f64], width: usize) -> Vec<f64> {
    let stride = width + 1;
    let mut table = vec![0.0; stride];
    for row in values.chunks(width) {
        let above = table.len() - stride;
        let mut sum = 0.0;
        table.push(0.0);
        for (x, value) in row.iter().enumerate() {
            sum += value;
            table.push(table[above + x + 1] + sum);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gray, but for two dotted patches.
    fn patches() -> Vec<f32> {
        let dot = |x: usize, y: usize| match (x, y) {
            (20..28, 4..12) => ((x + y) % 2) as f32,
            (3..11, 18..26) => ((x + y) % 2) as f32 * 0.5,
            _ => 0.5,
        };
        (0..40 * 30)
            .flat_map(|i| [dot(i % 40, i / 40); 3])
            .collect()
    }

    #[test]
    fn the_two_patches_with_texture_are_found_from_left_to_right() {
        let rgb = patches();
        let [left, right] = worth_a_look(&[Image::new(40, 30, &rgb)], 10, 10);
        let covers = |rect: Rect, x: usize, y: usize| {
            (rect.left..=rect.left + 2).contains(&x) && (rect.top..=rect.top + 2).contains(&y)
        };
        assert!(covers(left, 3, 18), "{left:?}");
        assert!(covers(right, 20, 4), "{right:?}");
    }

    #[test]
    fn the_second_window_is_where_the_last_picture_gained_most() {
        let truth = patches();
        let flat = vec![0.5; truth.len()];
        // The weaker patch is all that the last picture has.
        let mut last = flat.clone();
        for i in (0..40 * 30).filter(|i| i / 40 >= 18) {
            last[3 * i..3 * i + 3].copy_from_slice(&truth[3 * i..3 * i + 3]);
        }
        let images = [&truth, &flat, &last].map(|rgb| Image::new(40, 30, rgb));
        let [left, right] = worth_a_look(&images, 8, 8);
        assert_eq!((left.left, left.top), (3, 18), "what was gained");
        assert_eq!((right.left, right.top), (20, 4), "what is hardest");
    }

    #[test]
    fn a_window_as_large_as_the_picture_is_the_picture() {
        let rgb = patches();
        let whole = Rect {
            left: 0,
            top: 0,
            width: 40,
            height: 30,
        };
        assert_eq!(
            worth_a_look(&[Image::new(40, 30, &rgb)], 40, 30),
            [whole, whole]
        );
    }
}
