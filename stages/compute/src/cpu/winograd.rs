//! 3x3 convolution of stride 1 by Winograd's minimal filtering, in tiles of 4x4 outputs: a quarter of the
//! multiplications. Lavin and Gray 2015, section 4. It knows where tiles and weights lie; the transforms are
//! `minimal_filter`'s, the products `tile`'s.

use std::ops::Range;

use super::buffer::Buffer;
use super::matrix::{Cut, Matrix, MatrixMut, Share};
pub use super::minimal_filter::Direction;
use super::minimal_filter::{
    LANES, SIDE, SIGHT, SPOTS, lines_of, transform_along, transform_down, transform_taps,
    untransform,
};
use super::simd::vectorize;
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use super::transpose::transpose_into;
use super::weight::Values;
use crate::conv::Geometry;
use crate::weight::Precision;

/// Tiles that are transformed before they are multiplied.
const TILES: usize = 128;
/// The most outputs per task: every transformed input is read once per task.
const OUTPUTS: usize = 4 * ROWS;
/// Tasks for the outputs of few channels.
const TASKS: usize = 6;
/// Inputs per product.
const DEPTH: usize = 128;
/// The fewest channels, in and out: upsamplers have 48, and take a third less time so. With fewer, plain sums take hardly
/// longer, and networks so narrow normalise groups of so few numbers that rounding shows.
const NARROWEST: usize = 48;
/// Channels per task of the inputs' transform.
const CHANNELS: usize = 4;

/// Whether the transforms pay: there must be enough products per transformed number, and full panels of tiles.
pub fn suits(g: &Geometry) -> bool {
    let tiles = g.batch * g.out_height.div_ceil(SIDE) * g.out_width.div_ceil(SIDE);
    let (direct, here) = (
        9 * g.batch * g.pixels(),
        SPOTS * tiles.next_multiple_of(COLUMNS),
    );
    g.kernel == [3, 3]
        && g.conv.stride == 1
        && g.channels.min(g.outputs) >= NARROWEST
        && direct >= 2 * here
}

/// Some rows of tiles, counted through all images.
struct Band<'a> {
    g: &'a Geometry,
    rows: Range<usize>,
}

/// Convolves every image of `x` with `weight`, and adds `bias`. `g` is the convolution to compute, whose inputs are
/// `weight`'s outputs if it is used backward.
pub fn convolve(
    x: &[f32],
    weight: Values,
    direction: Direction,
    bias: Option<&[f32]>,
    g: &Geometry,
) -> Buffer {
    let mut out = Buffer::stale(g.batch * g.outputs * g.pixels());
    let (across, down) = (g.out_width.div_ceil(SIDE), g.out_height.div_ceil(SIDE));
    let step = (TILES / across).max(1);
    for first in (0..g.batch * down).step_by(step) {
        let band = Band {
            g,
            rows: first..(first + step).min(g.batch * down),
        };
        let inputs = band.transform_inputs(x);
        // A panel is one row of pixels.
        let rows = Cut {
            matrices: g.batch,
            rows: g.outputs,
            columns: g.pixels(),
            panel: g.out_width,
            share_rows: g
                .outputs
                .div_ceil(TASKS)
                .next_multiple_of(ROWS)
                .min(OUTPUTS),
            share_panels: g.batch * g.out_height,
        };
        rows.for_each_share(&mut out, |mut share| {
            let sums = band.multiply(&inputs, weight, direction, share.rows.clone());
            for row in 0..share.rows.len() {
                let bias = bias.map_or(0.0, |bias| bias[share.rows.start + row]);
                band.transform_outputs(&sums, row, bias, &mut share);
            }
        });
    }
    out
}

impl Band<'_> {
    /// Tiles in one row.
    fn across(&self) -> usize {
        self.g.out_width.div_ceil(SIDE)
    }

    fn tiles(&self) -> usize {
        self.rows.len() * self.across()
    }

    fn panels(&self) -> usize {
        self.tiles().div_ceil(COLUMNS)
    }

    /// The image and the first output row of each row of tiles.
    fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        let down = self.g.out_height.div_ceil(SIDE);
        self.rows
            .clone()
            .map(move |row| (row / down, row % down * SIDE))
    }

    /// The transformed inputs: for each spot and panel of tiles, a packed panel `[channels, COLUMNS]`.
    fn transform_inputs(&self, x: &[f32]) -> Buffer {
        let g = self.g;
        let mut out = Buffer::stale(SPOTS * self.panels() * g.channels * COLUMNS);
        let cut = Cut {
            matrices: SPOTS * self.panels(),
            rows: g.channels,
            columns: COLUMNS,
            panel: COLUMNS,
            share_rows: CHANNELS,
            share_panels: SPOTS * self.panels(),
        };
        cut.for_each_share(&mut out, |mut share| {
            let width = SIDE * (self.across() + 1);
            let mut lines = vec![0.0; SIGHT * self.rows.len() * width];
            let mut spots = vec![0.0; SIGHT * self.rows.len() * (self.across() + 1) + LANES];
            let mut tiles = vec![0.0; self.panels() * COLUMNS + LANES];
            for (i, channel) in share.rows.clone().enumerate() {
                self.read_lines(x, channel, width, &mut lines);
                transform_down(&mut lines);
                for (line, values) in lines.chunks(self.rows.len() * width).enumerate() {
                    transform_along(values, &mut spots[..SIGHT * values.len() / SIDE]);
                    self.write_spots(line, i, &spots, &mut tiles, &mut share);
                }
            }
        });
        out
    }

    /// The six lines that each row of tiles sees, the first lines of all rows first; each `width` long, zero beyond
    /// the image.
    fn read_lines(&self, x: &[f32], channel: usize, width: usize, lines: &mut [f32]) {
        let (g, [top, _, left, _]) = (self.g, self.g.conv.pad);
        let end = (left + g.width).min(width);
        for (line, lines) in lines.chunks_mut(self.rows.len() * width).enumerate() {
            for ((image, y), out) in self.places().zip(lines.chunks_mut(width)) {
                let row = (y + line).wrapping_sub(top);
                out.fill(0.0);
                if row < g.height && left < end {
                    let start = ((image * g.channels + channel) * g.height + row) * g.width;
                    out[left..end].copy_from_slice(&x[start..start + end - left]);
                }
            }
        }
    }

    /// Moves one line of spots, `[SIGHT, rows, across + 1]`, to row `row` of the share's panels. `tiles` is space for
    /// one spot of all tiles.
    fn write_spots(
        &self,
        line: usize,
        row: usize,
        spots: &[f32],
        tiles: &mut [f32],
        share: &mut Share,
    ) {
        let across = self.across();
        for column in 0..SIGHT {
            let first_panel = (line * SIGHT + column) * self.panels();
            let spots = &spots[column * self.rows.len() * (across + 1)..];
            for i in 0..self.rows.len() {
                // Whole vectors: what one writes beyond its row, the next row overwrites.
                for start in (0..across).step_by(LANES) {
                    let to = i * across + start;
                    tiles[to..to + LANES].copy_from_slice(&spots[to + i..to + i + LANES]);
                }
            }
            for (panel, tiles) in tiles.chunks_exact(COLUMNS).enumerate().take(self.panels()) {
                share.block(row..row + 1, first_panel + panel).row(0)[..COLUMNS]
                    .copy_from_slice(tiles);
            }
        }
    }

    /// The products at every spot, `[SPOTS, outputs, panels * COLUMNS]`.
    fn multiply(
        &self,
        inputs: &[f32],
        weight: Values,
        direction: Direction,
        outputs: Range<usize>,
    ) -> Buffer {
        let (channels, width) = (self.g.channels, self.panels() * COLUMNS);
        let mut sums = Buffer::stale(SPOTS * outputs.len() * width);
        for first in (0..channels).step_by(DEPTH) {
            let depth = first..channels.min(first + DEPTH);
            let count = outputs.len() * depth.len();
            let old = if first == 0 { Old::Forget } else { Old::Keep };
            let kernels =
                transform_kernels(weight, direction, self.g, outputs.clone(), depth.clone());
            for (spot, sums) in sums.chunks_mut(outputs.len() * width).enumerate() {
                let kernels = &kernels[spot * count..(spot + 1) * count];
                let kernels = match direction {
                    Direction::Forward => Matrix::new(kernels, outputs.len(), depth.len()),
                    Direction::Backward => {
                        Matrix::new(kernels, depth.len(), outputs.len()).transposed()
                    }
                };
                let mut sums = MatrixMut::new(sums, outputs.len(), width);
                for panel in 0..self.panels() {
                    let start = ((spot * self.panels() + panel) * channels + depth.start) * COLUMNS;
                    let columns = panel * COLUMNS..(panel + 1) * COLUMNS;
                    for row in (0..outputs.len()).step_by(ROWS) {
                        let rows = row..outputs.len().min(row + ROWS);
                        let mut tile = sums.block(rows.clone(), columns.clone());
                        multiply_tile(
                            &mut tile,
                            kernels.rows(rows),
                            &inputs[start..],
                            (old, Precision::F32),
                        );
                    }
                }
            }
        }
        sums
    }

    /// Writes output channel `row` of the share.
    fn transform_outputs(&self, sums: &[f32], row: usize, bias: f32, share: &mut Share) {
        let (width, outputs) = (self.panels() * COLUMNS, share.rows.len());
        let mut lines = vec![0.0; SIDE * SIDE * width];
        for first in (0..width).step_by(LANES) {
            let spot = |spot: usize| &sums[(spot * outputs + row) * width + first..];
            let [a, b, c, d] =
                lines_of(&mut lines, SIDE * width).map(|line| &mut line[SIDE * first..]);
            vectorize(
                #[inline(always)]
                || untransform(std::array::from_fn(spot), bias, [a, b, c, d]),
            );
        }
        for (i, (image, y)) in self.places().enumerate() {
            for (dy, line) in lines
                .chunks(SIDE * width)
                .enumerate()
                .take(self.g.out_height - y)
            {
                let panel = image * self.g.out_height + y + dy;
                let line = &line[SIDE * i * self.across()..][..self.g.out_width];
                share
                    .block(row..row + 1, panel)
                    .row(0)
                    .copy_from_slice(line);
            }
        }
    }
}

/// The transformed kernels of some outputs and inputs, at each spot `[outputs, inputs]` forward and
/// `[inputs, outputs]` backward: the order in which they are stored.
fn transform_kernels(
    weight: Values,
    direction: Direction,
    g: &Geometry,
    outputs: Range<usize>,
    inputs: Range<usize>,
) -> Buffer {
    let (major, minor, stride) = match direction {
        Direction::Forward => (outputs, inputs, g.channels),
        Direction::Backward => (inputs, outputs, g.outputs),
    };
    let count = major.len() * minor.len();
    let mut taps = Buffer::stale(9 * count);
    for (i, taps) in major.zip(taps.chunks_mut(9 * minor.len())) {
        weight.widen((i * stride + minor.start) * 9, taps);
    }
    let mut out = Buffer::stale(SPOTS * count);
    let (mut panel, mut spots) = ([0.0; 9 * COLUMNS], [[0.0; COLUMNS]; SPOTS]);
    for first in (0..count).step_by(COLUMNS) {
        let columns = first..count.min(first + COLUMNS);
        transpose_into(
            &taps[9 * first..],
            9,
            [columns.len(), 9],
            &mut panel,
            COLUMNS,
        );
        vectorize(
            #[inline(always)]
            || transform_taps(&panel, direction, &mut spots),
        );
        for (out, spot) in out.chunks_mut(count).zip(&spots) {
            out[columns.clone()].copy_from_slice(&spot[..columns.len()]);
        }
    }
    out
}
