//! A panel: some tiles, counted row by row through all images, as the columns of a product. It finds the pixels of its
//! tiles; what is done with them is the kernels' business.

use std::ops::Range;

use super::kernels::{Lines, SEEN, TransformInputs, TransformOutputs};
use super::quads::run;
use super::transform::{SIDE, SIGHT, SPOTS};
use crate::conv::{Finish, Geometry};
use crate::cpu::matrix::{Cut, MatrixMut, Share};
use crate::cpu::tile::COLUMNS;

/// What tiles see of lines beyond the image.
const ZEROS: [f32; SEEN] = [0.0; SEEN];

/// At most [`COLUMNS`] tiles.
pub struct Panel<'a> {
    pub g: &'a Geometry,
    pub tiles: Range<usize>,
}

/// Neighbouring tiles of a panel in one row of tiles.
struct Run {
    image: usize,
    /// The row of tiles within the image.
    row: usize,
    /// The first tile within the row.
    tile: usize,
    /// Its place in the panel.
    at: usize,
    count: usize,
}

/// Tiles in one row of them.
pub fn across(g: &Geometry) -> usize {
    g.out_width.div_ceil(SIDE)
}

/// Rows of tiles in one image.
pub fn down(g: &Geometry) -> usize {
    g.out_height.div_ceil(SIDE)
}

/// The result `[N, O, H, W]` cut by rows of tiles: one is a panel of up to four lines of pixels.
pub fn cut(g: &Geometry, share_rows: usize, share_panels: usize) -> Cut {
    Cut {
        matrices: g.batch,
        rows: g.outputs,
        columns: g.pixels(),
        panel: SIDE * g.out_width,
        share_rows,
        share_panels,
    }
}

impl<'a> Panel<'a> {
    /// The panels of all tiles in `rows`, which are rows of tiles.
    pub fn all(g: &'a Geometry, rows: Range<usize>) -> impl Iterator<Item = Panel<'a>> {
        let tiles = rows.start * across(g)..rows.end * across(g);
        tiles.clone().step_by(COLUMNS).map(move |first| Panel {
            g,
            tiles: first..tiles.end.min(first + COLUMNS),
        })
    }

    fn runs(&self) -> impl Iterator<Item = Run> {
        let (across, down) = (across(self.g), down(self.g));
        let tiles = self.tiles.clone();
        (tiles.start / across..tiles.end.div_ceil(across)).map(move |row| {
            let first = tiles.start.max(row * across);
            Run {
                image: row / down,
                row: row % down,
                tile: first - row * across,
                at: first - tiles.start,
                count: tiles.end.min((row + 1) * across) - first,
            }
        })
    }

    /// B^T x B of one channel of `x`: (S, P).
    pub fn transform_inputs(
        &self,
        x: &[f32],
        channel: usize,
        lines: &mut Lines,
        spots: &mut MatrixMut,
    ) {
        let g = self.g;
        let [top, _, left, _] = g.conv.pad;
        for tiles in self.runs() {
            let plane = &x[(tiles.image * g.channels + channel) * g.plane()..][..g.plane()];
            // The pixels that the tiles see lie `left` further left in the image: `begin..end`, as far as there are any.
            let first = SIDE * tiles.tile;
            let begin = first.saturating_sub(left).min(g.width);
            let end = (first + SIDE * tiles.count + SIGHT - SIDE)
                .saturating_sub(left)
                .clamp(begin, g.width);
            let zeros = (left + begin - first).min(SIDE * tiles.count + SIGHT - SIDE);
            let source = std::array::from_fn(|line| {
                let y = (SIDE * tiles.row + line).wrapping_sub(top);
                if y < g.height {
                    &plane[y * g.width + begin..y * g.width + end]
                } else {
                    &ZEROS[..end - begin]
                }
            });
            run(TransformInputs {
                source,
                zeros,
                lines,
                spots: spots.block(0..SPOTS, 0..COLUMNS),
                at: tiles.at,
                count: tiles.count,
            });
        }
    }

    /// A^T m A of one output channel, number `row` of the share: its pixels. `spots` is (S, P), and some numbers beyond.
    pub fn transform_outputs(
        &self,
        spots: &[f32],
        (share, row): (&mut Share, usize),
        bias: f32,
        finish: Finish<&[f32]>,
    ) {
        let g = self.g;
        for tiles in self.runs() {
            let plane = tiles.image * g.outputs + share.rows.start + row;
            let first = plane * g.pixels() + SIDE * tiles.row * g.out_width;
            let mut block = share.block(row..row + 1, tiles.image * down(g) + tiles.row);
            let lines = block.row(0);
            run(TransformOutputs {
                spots,
                at: tiles.at,
                count: tiles.count,
                bias,
                finish: finish.map(|other| &other[first..first + lines.len()]),
                lines,
                width: g.out_width,
                x: SIDE * tiles.tile,
            });
        }
    }
}
