//! Finds where a picture has most detail, for crops worth a look. Knows nothing of drawing.

use super::canvas::Rect;
use crate::Image;

/// The windows of `width * height` with the most detail: the best, then the best once the first is
/// blotted out; in the order of their columns. Both sides must fit the image. The upper left one
/// wins a tie.
pub(super) fn most_detailed(image: Image, width: usize, height: usize) -> [Rect; 2] {
    let mut detail = gradients(image);
    let first = best_window(&detail, image.width(), width, height);
    for y in first.top..first.top + height {
        detail[y * image.width() + first.left..][..width].fill(0.0);
    }
    let second = best_window(&detail, image.width(), width, height);
    if second.left < first.left {
        [second, first]
    } else {
        [first, second]
    }
}

/// `|dx| + |dy|` of the green channel per pixel, zero on the last column and row.
fn gradients(image: Image) -> Vec<f64> {
    let width = image.width();
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
        let [left, right] = most_detailed(Image::new(40, 30, &rgb), 10, 10);
        let covers = |rect: Rect, x: usize, y: usize| {
            (rect.left..=rect.left + 2).contains(&x) && (rect.top..=rect.top + 2).contains(&y)
        };
        assert!(covers(left, 3, 18), "{left:?}");
        assert!(covers(right, 20, 4), "{right:?}");
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
            most_detailed(Image::new(40, 30, &rgb), 40, 30),
            [whole, whole]
        );
    }
}
