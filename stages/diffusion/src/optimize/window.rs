//! The rectangle of a view that a step looks at. Knows no view.

use compute::{Array, shape};

/// A rectangle of latent pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Row of its first pixel, from 0.
    pub top: usize,
    /// Column of its first pixel, from 0.
    pub left: usize,
    /// How many rows it has.
    pub height: usize,
    /// How many columns it has.
    pub width: usize,
}

impl Window {
    /// A window of the given height and width around a pixel drawn evenly from the view, moved
    /// inside where it would reach over the border: so that pixels near the border, which few
    /// windows can cover, are seen more often than by an evenly drawn corner. `draw` gives a number
    /// below its argument, for the row and then for the column.
    pub fn around_any_pixel(
        size: [usize; 2],
        view: [usize; 2],
        draw: impl Fn(u64, u32) -> u32,
    ) -> Self {
        let start = |axis: usize| {
            // A window is no larger than the smallest view, so that the subtraction below cannot
            // wrap.
            let centre = draw(axis as u64, view[axis] as u32) as usize;
            centre
                .saturating_sub(size[axis] / 2)
                .min(view[axis] - size[axis])
        };
        Self {
            top: start(0),
            left: start(1),
            height: size[0],
            width: size[1],
        }
    }

    /// The part of `map [C, H, W]` inside, as `[1, C, height, width]`.
    pub fn crop(&self, map: &Array) -> Array {
        let [channels, height, width] = [0, 1, 2].map(|axis| map.shape()[axis]);
        let image = map.reshape(&[1, channels, height, width]);
        shape::crop(&image, self.top, self.left, self.height, self.width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Rng;

    fn windows() -> impl Iterator<Item = Window> {
        let rng = Rng::new(0, "test");
        (0..2000).map(move |step| {
            Window::around_any_pixel([4, 6], [10, 12], |axis, n| rng.below(step, axis, n))
        })
    }

    #[test]
    fn windows_stay_inside_and_reach_every_border() {
        assert!(
            windows().all(|w| w.top + 4 <= 10 && w.left + 6 <= 12 && (w.height, w.width) == (4, 6))
        );
        for (top, left) in [(0, 0), (0, 6), (6, 0), (6, 6)] {
            assert!(
                windows().any(|w| (w.top, w.left) == (top, left)),
                "none at ({top}, {left})"
            );
        }
    }

    #[test]
    fn a_window_as_large_as_the_view_is_the_view() {
        let all = Window::around_any_pixel([4, 6], [4, 6], |_, n| n - 1);
        assert_eq!(
            all,
            Window {
                top: 0,
                left: 0,
                height: 4,
                width: 6
            }
        );
    }
}
