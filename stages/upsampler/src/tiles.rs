//! Takes a large image in windows that overlap, so that memory is bounded by one of them.
//!
//! Of each window only the part is kept that lies further from its inner edges than the network
//! reaches; so the result is that of the whole image, but for rounding. Of networks that reach
//! further than [`MARGIN`] it is nearly that: what lies so far away hardly changes a pixel.

use compute::Array;
use compute::shape::{concat, crop, pad_reflect, slice};

use crate::network::{Facts, Network};

/// The widest margin around what is kept of a window.
// RRDBNet with 23 blocks reaches 350 pixels, but nearly all of the weight lies near.
pub const MARGIN: usize = 48;
/// What is kept begins at multiples of this, where convolutions begin their own tiles.
const STEP: usize = 12;

/// A window along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    /// What the network sees.
    start: usize,
    end: usize,
    /// What is kept of it.
    kept_start: usize,
    kept_end: usize,
}

/// How wide a margin the network's windows have.
pub fn margin(facts: &Facts) -> usize {
    facts.reach.min(MARGIN).next_multiple_of(STEP)
}

/// The windows along an axis: as few as `tile` allows, and evenly spread.
fn windows(extent: usize, tile: usize, margin: usize) -> Vec<Window> {
    if extent <= tile {
        return vec![Window {
            start: 0,
            end: extent,
            kept_start: 0,
            kept_end: extent,
        }];
    }
    // What is kept of a tile, in whole steps, so that all windows' convolutions are cut alike.
    let room = tile.saturating_sub(2 * margin).max(STEP) / STEP * STEP;
    // Fewer windows compute fewer margins twice.
    let count = extent.div_ceil(room);
    // Evenly, so that the last window is no sliver.
    let kept = extent.div_ceil(count).next_multiple_of(STEP);
    let window = |kept_start: usize| {
        let kept_end = (kept_start + kept).min(extent);
        let start = kept_start.saturating_sub(margin);
        let end = (kept_end + margin).min(extent);
        Window {
            start,
            end,
            kept_start,
            kept_end,
        }
    };
    (0..extent).step_by(kept).map(window).collect()
}

/// `x [N, 3, H, W]` enlarged by `network`, in windows of at most `tile` pixels a side, margins and
/// all.
pub fn enlarge(network: &dyn Network, x: &Array, tile: usize) -> Array {
    let (facts, &[n, _, height, width]) = (network.facts(), x.shape()) else {
        panic!("enlarge: {:?}", x.shape())
    };
    let x = whole_grains(x, facts.grain);
    let scale = facts.scale;
    let margin = margin(&facts);
    let [rows, columns] = [x.shape()[2], x.shape()[3]].map(|extent| windows(extent, tile, margin));
    let whole = [scale * x.shape()[2], scale * x.shape()[3]];
    let enlarged = if rows.len() * columns.len() == 1 {
        network.forward(&x)
    } else {
        // On the host, since only one window's values need to be on the device at a time.
        let mut canvas = vec![0.0; n * 3 * whole[0] * whole[1]];
        for row in &rows {
            for column in &columns {
                let window = crop(
                    &x,
                    row.start,
                    column.start,
                    row.end - row.start,
                    column.end - column.start,
                );
                keep(
                    &mut canvas,
                    whole,
                    &network.forward(&window),
                    [row, column],
                    scale,
                );
            }
        }
        x.device().array(&[n, 3, whole[0], whole[1]], canvas)
    };
    if whole == [scale * height, scale * width] {
        enlarged
    } else {
        crop(&enlarged, 0, 0, scale * height, scale * width)
    }
}

/// Copies what is kept of a window's result to its place.
fn keep(
    canvas: &mut [f32],
    [height, width]: [usize; 2],
    result: &Array,
    [row, column]: [&Window; 2],
    scale: usize,
) {
    let planes = result.shape()[0] * result.shape()[1];
    let [h, w] = [result.shape()[2], result.shape()[3]];
    let values = result.to_vec();
    let len = scale * (column.kept_end - column.kept_start);
    for plane in 0..planes {
        for y in scale * row.kept_start..scale * row.kept_end {
            let source = (plane * h + y - scale * row.start) * w
                + scale * (column.kept_start - column.start);
            let target = (plane * height + y) * width + scale * column.kept_start;
            canvas[target..target + len].copy_from_slice(&values[source..source + len]);
        }
    }
}

/// `x [N, C, H, W]` continued by mirroring until its sides are multiples of `grain`.
fn whole_grains(x: &Array, grain: usize) -> Array {
    let mut x = x.clone();
    for axis in [2, 3] {
        // Mirroring reaches one pixel less than the image; a small one is mirrored again.
        while !x.shape()[axis].is_multiple_of(grain) {
            let extent = x.shape()[axis];
            let missing = grain - x.shape()[axis] % grain;
            x = match (extent, axis) {
                (1, _) => concat(&[&x, &slice(&x, axis, 0, 1)], axis),
                (_, 2) => pad_reflect(&x, [0, missing.min(extent - 1), 0, 0]),
                _ => pad_reflect(&x, [0, 0, 0, missing.min(extent - 1)]),
            };
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_cover_an_axis_once_and_see_their_margins() {
        for extent in 1..700 {
            for (tile, margin) in [(128, 24), (128, 48), (256, 24), (96, 48)] {
                let windows = windows(extent, tile, margin);
                let mut next = 0;
                for w in &windows {
                    assert_eq!(w.kept_start, next);
                    assert!(
                        w.kept_end > w.kept_start && w.end - w.start <= tile.max(2 * margin + STEP),
                        "{w:?}"
                    );
                    assert!(w.start == 0 || w.kept_start - w.start == margin, "{w:?}");
                    assert!(w.end == extent || w.end - w.kept_end == margin, "{w:?}");
                    next = w.kept_end;
                }
                assert_eq!(next, extent);
                assert!(extent > tile || windows.len() == 1);
            }
        }
    }

    #[test]
    fn the_smallest_images_are_continued_to_whole_grains() {
        let device = compute::Device::cpu();
        for (h, w) in [(1, 1), (1, 3), (2, 5), (5, 4)] {
            let x = device.array(&[1, 1, h, w], (0..h * w).map(|i| i as f32).collect());
            let padded = whole_grains(&x, 4);
            assert_eq!(
                padded.shape(),
                [1, 1, h.next_multiple_of(4), w.next_multiple_of(4)]
            );
            assert_eq!(crop(&padded, 0, 0, h, w).to_vec(), x.to_vec());
        }
    }
}
