//! A panel: some tiles, counted row by row through all images, as the columns of a product. It
//! finds the pixels of its tiles; what is done with them is the kernels' business.

use std::ops::Range;

use super::extents::{COLUMNS, SEEN, SIDE, SIGHT, SPOTS};
use super::kernels::{Lines, TransformInputs, TransformOutputs};
use super::quads::run;
use crate::ops::conv::geometry::Geometry;
use crate::ops::product::finish::Finish;
use crate::runtime::cpu::matrix::MatrixMut;
use crate::runtime::cpu::share::{Cut, Share};
use crate::runtime::cpu::simd::prefetch;

/// What tiles see of lines beyond the image.
const ZEROS: [f32; SEEN] = [0.0; SEEN];

/// Channels between what is transformed and what is asked of memory.
const AHEAD: usize = 2;

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
        let across = across(self.g);
        let down = down(self.g);
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
        for tiles in self.runs() {
            let (zeros, columns) = self.columns(&tiles);
            let ahead = channel + AHEAD;
            for line in 0..SIGHT {
                if ahead < g.channels {
                    prefetch(self.line(x, ahead, &tiles, line, columns.clone()));
                }
            }
            run(TransformInputs {
                source: std::array::from_fn(|line| {
                    self.line(x, channel, &tiles, line, columns.clone())
                }),
                zeros,
                lines,
                spots: spots.block(0..SPOTS, 0..COLUMNS),
                at: tiles.at,
                count: tiles.count,
            });
        }
    }

    /// The image's columns that some tiles see, and how many they see before its first. They begin
    /// as far left of the tiles as the image is padded.
    fn columns(&self, tiles: &Run) -> (usize, Range<usize>) {
        let [_, _, left, _] = self.g.conv.pad;
        let seen = SIDE * tiles.count + SIGHT - SIDE;
        let first = SIDE * tiles.tile;
        // Tiles may lie wholly in the padding: then no column is left.
        let begin = first.saturating_sub(left).min(self.g.width);
        let end = (first + seen)
            .saturating_sub(left)
            .clamp(begin, self.g.width);
        (left.saturating_sub(first).min(seen), begin..end)
    }

    /// Those columns of one of the six lines that the tiles see.
    fn line<'x>(
        &self,
        x: &'x [f32],
        channel: usize,
        tiles: &Run,
        line: usize,
        columns: Range<usize>,
    ) -> &'x [f32] {
        let g = self.g;
        // A line above the image wraps around to one beyond it.
        let y = (SIDE * tiles.row + line).wrapping_sub(g.conv.pad[0]);
        if y >= g.height {
            return &ZEROS[..columns.len()];
        }
        let first = ((tiles.image * g.channels + channel) * g.height + y) * g.width;
        &x[first + columns.start..first + columns.end]
    }

    /// Asks for what [`transform_outputs`](Self::transform_outputs) will read and write.
    pub fn prefetch_outputs(&self, (share, row): (&mut Share, usize), finish: Finish<&[f32]>) {
        let g = self.g;
        for tiles in self.runs() {
            // The last tile of a row may reach beyond the image.
            let x = SIDE * tiles.tile..g.out_width.min(SIDE * (tiles.tile + tiles.count));
            let first = self.first(&tiles, share, row);
            let mut block = share.block(row..row + 1, tiles.image * down(g) + tiles.row);
            for (y, line) in block.row(0).chunks(g.out_width).enumerate() {
                prefetch(&line[x.clone()]);
                if let Finish::Add(other) = finish {
                    let line = &other[first + y * g.out_width..];
                    prefetch(&line[x.clone()]);
                }
            }
        }
    }

    /// Where the lines of some tiles begin in the whole result, in output channel `row` of the
    /// share.
    fn first(&self, tiles: &Run, share: &Share, row: usize) -> usize {
        let plane = tiles.image * self.g.outputs + share.rows.start + row;
        plane * self.g.pixels() + SIDE * tiles.row * self.g.out_width
    }

    /// A^T m A of one output channel, number `row` of the share: its pixels. `spots` is (S, P), and
    /// some numbers beyond.
    pub fn transform_outputs(
        &self,
        spots: &[f32],
        (share, row): (&mut Share, usize),
        bias: f32,
        finish: Finish<&[f32]>,
    ) {
        let g = self.g;
        for tiles in self.runs() {
            let first = self.first(&tiles, share, row);
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
