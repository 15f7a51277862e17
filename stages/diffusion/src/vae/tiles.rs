//! Covers a large image with overlapping tiles and blends what is computed for each, so that memory
//! is bounded by one tile.
//!
//! Knows positions and weights, not what is computed.

use compute::Array;

use super::statistics::Statistics;

/// The tiles along one axis.
struct Axis {
    extent: usize,
    tile: usize,
    starts: Vec<usize>,
}

/// The tiles over an image.
pub(super) struct Tiling {
    axes: [Axis; 2],
}

impl Axis {
    /// Tiles of equal size, evenly spread, that overlap by at least a quarter.
    fn new(extent: usize, tile: usize) -> Self {
        if extent <= tile {
            return Self {
                extent,
                tile: extent,
                starts: vec![0],
            };
        }
        // Starts of neighbours may be three quarters of a tile apart at most.
        let gaps = (extent - tile).div_ceil(tile - tile / 4);
        Self {
            extent,
            tile,
            // Multiplied before it is divided: the last tile ends exactly at the border.
            starts: (0..=gaps).map(|i| i * (extent - tile) / gaps).collect(),
        }
    }

    /// The share of each tile in each position of the result, which has `unit` positions for one of
    /// the axis; the shares of all tiles add up to 1. A share grows linearly from an edge inside
    /// the image and is level beyond a quarter of the tile.
    fn shares(&self, unit: usize) -> Vec<Vec<f32>> {
        let tile = self.tile * unit;
        let ramp = (self.tile * unit).div_ceil(4) as f32;
        let weight = |start: usize, i: usize| {
            // Half a pixel inside: no weight is 0, so the total that is divided by is not either.
            let before = if start == 0 { ramp } else { i as f32 + 0.5 };
            let after = if start + self.tile == self.extent {
                ramp
            } else {
                (tile - i) as f32 - 0.5
            };
            before.min(after).min(ramp)
        };
        let mut total = vec![0.0; self.extent * unit];
        for &start in &self.starts {
            (0..tile).for_each(|i| total[start * unit + i] += weight(start, i));
        }
        let share = |start: usize| {
            (0..tile)
                .map(|i| weight(start, i) / total[start * unit + i])
                .collect()
        };
        self.starts.iter().map(|&start| share(start)).collect()
    }
}

impl Tiling {
    /// Tiles of at most `tile` by `tile` over an image of `[height, width]`.
    pub fn new(size: [usize; 2], tile: usize) -> Self {
        Self {
            axes: size.map(|extent| Axis::new(extent, tile)),
        }
    }

    /// The result for the whole image, `unit` times its size, blended from those of tiles.
    /// `compute` is given the first pixel `[top, left]` and the size `[height, width]` of a tile
    /// and gives `[N, C, unit height, unit width]`. Where there is more than one tile it is called
    /// twice for each: once to gather statistics, once to use those of all.
    pub fn blend(
        &self,
        unit: usize,
        compute: impl Fn([usize; 2], [usize; 2], &mut Statistics) -> Array,
    ) -> Array {
        let [rows, columns] = &self.axes;
        let tile = [rows.tile, columns.tile];
        // One tile sees the whole image: its own statistics are right, and one pass will do.
        if rows.starts.len() * columns.starts.len() == 1 {
            return compute([0, 0], tile, &mut Statistics::Own);
        }
        // What this walk computes is thrown away; it is for the normalisations' statistics.
        let mut statistics = Statistics::Gather(Vec::new());
        for (&top, &left) in rows
            .starts
            .iter()
            .flat_map(|top| columns.starts.iter().map(move |left| (top, left)))
        {
            compute([top, left], tile, &mut statistics);
        }
        let mut statistics = statistics.pooled();
        let row_shares = rows.shares(unit);
        let column_shares = columns.shares(unit);
        let mut canvas = Canvas {
            size: [rows.extent * unit, columns.extent * unit],
            sums: None,
        };
        for (&top, row_share) in rows.starts.iter().zip(&row_shares) {
            for (&left, column_share) in columns.starts.iter().zip(&column_shares) {
                canvas.add(
                    &compute([top, left], tile, &mut statistics),
                    [top * unit, left * unit],
                    row_share,
                    column_share,
                );
            }
        }
        canvas.finish()
    }
}

/// The weighted sum of tiles, on the host.
struct Canvas {
    size: [usize; 2],
    sums: Option<(Vec<f32>, Array)>,
}

impl Canvas {
    fn add(
        &mut self,
        tile: &Array,
        [top, left]: [usize; 2],
        row_share: &[f32],
        column_share: &[f32],
    ) {
        let planes = tile.shape()[0] * tile.shape()[1];
        let [height, width] = self.size;
        let (sums, _) = self
            .sums
            .get_or_insert_with(|| (vec![0.0; planes * height * width], tile.clone()));
        // [N, C, h, w]: rows come one behind the other, then planes.
        for (row, values) in tile.to_vec().chunks_exact(column_share.len()).enumerate() {
            let plane = row / row_share.len();
            let y = row % row_share.len();
            let first = (plane * height + top + y) * width + left;
            for ((sum, value), share) in sums[first..].iter_mut().zip(values).zip(column_share) {
                *sum += row_share[y] * share * value;
            }
        }
    }

    fn finish(self) -> Array {
        let (sums, like) = self
            .sums
            .unwrap_or_else(|| unreachable!("an image has at least one tile"));
        let shape = [like.shape()[0], like.shape()[1], self.size[0], self.size[1]];
        like.device().array(&shape, sums)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;
    use compute::shape::{crop, upsample_nearest};

    fn numbers(size: [usize; 2]) -> Array {
        let values = (0..2 * size[0] * size[1])
            .map(|i| (i as f32 * 0.37).sin())
            .collect();
        Device::cpu().array(&[1, 2, size[0], size[1]], values)
    }

    #[test]
    fn tiles_that_agree_blend_into_the_whole() {
        for (size, tile) in [([9, 31], 8), ([8, 8], 8), ([40, 5], 12), ([33, 17], 16)] {
            let image = numbers(size);
            for unit in [1, 4] {
                let doubled = |[top, left]: [usize; 2], [h, w]: [usize; 2], _: &mut Statistics| {
                    upsample_nearest(&crop(&image, top, left, h, w), unit)
                };
                let blended = Tiling::new(size, tile).blend(unit, doubled).to_vec();
                let whole = upsample_nearest(&image, unit).to_vec();
                assert_eq!(blended.len(), whole.len());
                let worst = blended
                    .iter()
                    .zip(&whole)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f32::max);
                assert!(worst < 1e-6, "{size:?} in tiles of {tile}: {worst}");
            }
        }
    }

    #[test]
    fn tiles_are_of_one_size_and_overlap_by_a_quarter() {
        for extent in 17..200 {
            let axis = Axis::new(extent, 16);
            assert_eq!(
                (axis.starts[0], axis.starts[axis.starts.len() - 1]),
                (0, extent - 16)
            );
            assert!(
                axis.starts.windows(2).all(|pair| pair[1] - pair[0] <= 12),
                "{extent}: {:?}",
                axis.starts
            );
        }
    }

    #[test]
    fn a_difference_between_tiles_fades_linearly() {
        let tiling = Tiling::new([8, 14], 8);
        let constant = |[_, left]: [usize; 2], [h, w]: [usize; 2], _: &mut Statistics| {
            Device::cpu().full(&[1, 1, h, w], (left > 0) as u8 as f32)
        };
        let row = &tiling.blend(1, constant).to_vec()[..14];
        assert_eq!(
            row,
            [0., 0., 0., 0., 0., 0., 0.25, 0.75, 1., 1., 1., 1., 1., 1.]
        );
    }
}
