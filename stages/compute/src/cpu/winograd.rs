//! 3x3 convolution of stride 1 by Winograd's minimal filtering, in tiles of 4x4 outputs: a quarter of the
//! multiplications. Lavin and Gray 2015, section 4, with the points 0, ±3/4, ±3/2 and infinity, which lose half as
//! many bits as theirs: some five times the rounding error of plain summation, about 2e-6 of the norm.
//!
//! It knows where tiles and weights lie; the products themselves are `tile`'s.

use std::ops::Range;

use super::buffer::Buffer;
use super::matrix::{Cut, Matrix, MatrixMut, Share};
use super::simd::vectorize;
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use super::transpose::transpose_into;
use super::weight::Values;
use crate::conv::Geometry;

/// Outputs of a tile, each way.
const SIDE: usize = 4;
/// Inputs that a tile sees, each way.
const SIGHT: usize = 6;
/// Numbers of a transformed tile.
const SPOTS: usize = SIGHT * SIGHT;
/// Tiles that are transformed before they are multiplied.
const TILES: usize = 128;
/// Outputs per task; with [`DEPTH`], what it holds of sums and weights fits the second cache.
const OUTPUTS: usize = 2 * ROWS;
/// Inputs per product.
const DEPTH: usize = 128;
/// Channels per task of the inputs' transform.
const CHANNELS: usize = 4;

/// The two positive points, A and B, and their powers.
const A: f32 = 0.75;
const B: f32 = 1.5;
const AA: f32 = A * A;
const BB: f32 = B * B;

/// Which way the kernels are used.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// `[O, C, 3, 3]` as they are.
    Forward,
    /// As the gradient to the input uses them: `[C, O]`, with the taps in reverse.
    Backward,
}

/// Whether the transforms pay: there must be enough products per transformed number, and full panels of tiles.
pub fn suits(g: &Geometry) -> bool {
    let tiles = g.batch * g.out_height.div_ceil(SIDE) * g.out_width.div_ceil(SIDE);
    let (direct, here) = (9 * g.batch * g.pixels(), SPOTS * tiles.next_multiple_of(COLUMNS));
    g.kernel == [3, 3] && g.conv.stride == 1 && g.channels.min(g.outputs) >= 16 && direct >= 2 * here
}

/// Some rows of tiles, counted through all images.
struct Band<'a> {
    g: &'a Geometry,
    rows: Range<usize>,
}

/// Convolves every image of `x` with `weight`, and adds `bias`. `g` is the convolution to compute, whose inputs are
/// `weight`'s outputs if it is used backward.
pub fn convolve(x: &[f32], weight: Values, direction: Direction, bias: Option<&[f32]>, g: &Geometry) -> Buffer {
    let mut out = Buffer::stale(g.batch * g.outputs * g.pixels());
    let (across, down) = (g.out_width.div_ceil(SIDE), g.out_height.div_ceil(SIDE));
    let step = (TILES / across).max(1);
    for first in (0..g.batch * down).step_by(step) {
        let band = Band { g, rows: first..(first + step).min(g.batch * down) };
        let inputs = band.transform_inputs(x);
        // A panel is one row of pixels.
        let rows = Cut {
            matrices: g.batch,
            rows: g.outputs,
            columns: g.pixels(),
            panel: g.out_width,
            share_rows: OUTPUTS,
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
        self.rows.clone().map(move |row| (row / down, row % down * SIDE))
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
            let mut spots = vec![0.0; SIGHT * self.rows.len() * (self.across() + 1)];
            for (i, channel) in share.rows.clone().enumerate() {
                self.read_lines(x, channel, width, &mut lines);
                transform_down(&mut lines);
                for (line, values) in lines.chunks(self.rows.len() * width).enumerate() {
                    transform_along(values, &mut spots);
                    self.write_spots(line, i, &spots, &mut share);
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

    /// Moves one line of spots, `[SIGHT, rows, across + 1]`, to row `row` of the share's panels.
    fn write_spots(&self, line: usize, row: usize, spots: &[f32], share: &mut Share) {
        let across = self.across();
        for (column, spots) in spots.chunks(self.rows.len() * (across + 1)).enumerate() {
            let first_panel = (line * SIGHT + column) * self.panels();
            for (i, spots) in spots.chunks(across + 1).enumerate() {
                let (mut tile, mut rest) = (i * across, &spots[..across]);
                while !rest.is_empty() {
                    let lane = tile % COLUMNS;
                    let (now, later) = rest.split_at(rest.len().min(COLUMNS - lane));
                    let mut block = share.block(row..row + 1, first_panel + tile / COLUMNS);
                    block.row(0)[lane..lane + now.len()].copy_from_slice(now);
                    (tile, rest) = (tile + now.len(), later);
                }
            }
        }
    }

    /// The products at every spot, `[SPOTS, outputs, panels * COLUMNS]`.
    fn multiply(&self, inputs: &[f32], weight: Values, direction: Direction, outputs: Range<usize>) -> Buffer {
        let (channels, width) = (self.g.channels, self.panels() * COLUMNS);
        let mut sums = Buffer::stale(SPOTS * outputs.len() * width);
        for first in (0..channels).step_by(DEPTH) {
            let depth = first..channels.min(first + DEPTH);
            let count = outputs.len() * depth.len();
            let old = if first == 0 { Old::Forget } else { Old::Keep };
            let kernels = transform_kernels(weight, direction, self.g, outputs.clone(), depth.clone());
            for (spot, sums) in sums.chunks_mut(outputs.len() * width).enumerate() {
                let kernels = &kernels[spot * count..(spot + 1) * count];
                let kernels = match direction {
                    Direction::Forward => Matrix::new(kernels, outputs.len(), depth.len()),
                    Direction::Backward => Matrix::new(kernels, depth.len(), outputs.len()).transposed(),
                };
                let mut sums = MatrixMut::new(sums, outputs.len(), width);
                for panel in 0..self.panels() {
                    let start = ((spot * self.panels() + panel) * channels + depth.start) * COLUMNS;
                    let columns = panel * COLUMNS..(panel + 1) * COLUMNS;
                    for row in (0..outputs.len()).step_by(ROWS) {
                        let rows = row..outputs.len().min(row + ROWS);
                        let mut tile = sums.block(rows.clone(), columns.clone());
                        multiply_tile(&mut tile, kernels.rows(rows), &inputs[start..], old);
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
            let [a, b, c, d] = lines_of(&mut lines, SIDE * width).map(|line| &mut line[SIDE * first..]);
            vectorize(
                #[inline(always)]
                || untransform(std::array::from_fn(spot), bias, [a, b, c, d]),
            );
        }
        for (i, (image, y)) in self.places().enumerate() {
            for (dy, line) in lines.chunks(SIDE * width).enumerate().take(self.g.out_height - y) {
                let panel = image * self.g.out_height + y + dy;
                let line = &line[SIDE * i * self.across()..][..self.g.out_width];
                share.block(row..row + 1, panel).row(0).copy_from_slice(line);
            }
        }
    }
}

/// The four lines of `len` elements.
fn lines_of(lines: &mut [f32], len: usize) -> [&mut [f32]; SIDE] {
    let (ab, cd) = lines.split_at_mut(2 * len);
    let ((a, b), (c, d)) = (ab.split_at_mut(len), cd.split_at_mut(len));
    [a, b, c, d]
}

/// B^T of six numbers.
#[inline(always)]
fn input_transform(d: [f32; SIGHT]) -> [f32; SIGHT] {
    let (even_a, odd_a) = (d[4] - BB * d[2], A * (d[3] - BB * d[1]));
    let (even_b, odd_b) = (d[4] - AA * d[2], B * (d[3] - AA * d[1]));
    let ends = |x: f32, y: f32, z: f32| AA * BB * x - (AA + BB) * y + z;
    [ends(d[0], d[2], d[4]), even_a + odd_a, even_a - odd_a, even_b + odd_b, even_b - odd_b, ends(d[1], d[3], d[5])]
}

/// A^T of six numbers.
#[inline(always)]
fn output_transform(m: [f32; SIGHT]) -> [f32; SIDE] {
    let (sum_a, difference_a, sum_b, difference_b) = (m[1] + m[2], m[1] - m[2], m[3] + m[4], m[3] - m[4]);
    [
        m[0] + sum_a + sum_b,
        A * difference_a + B * difference_b,
        AA * sum_a + BB * sum_b,
        A * AA * difference_a + B * BB * difference_b + m[5],
    ]
}

/// B^T down the six lines, in place.
fn transform_down(lines: &mut [f32]) {
    let len = lines.len() / SIGHT;
    let (abc, def) = lines.split_at_mut(3 * len);
    let ((a, bc), (d, ef)) = (abc.split_at_mut(len), def.split_at_mut(len));
    let ((b, c), (e, f)) = (bc.split_at_mut(len), ef.split_at_mut(len));
    vectorize(
        #[inline(always)]
        || {
            for (((((a, b), c), d), e), f) in a.iter_mut().zip(b).zip(c).zip(d).zip(e).zip(f) {
                [*a, *b, *c, *d, *e, *f] = input_transform([*a, *b, *c, *d, *e, *f]);
            }
        },
    );
}

/// B^T along a line: `spots [SIGHT, len / SIDE]`, of which the last of each tile row means nothing.
fn transform_along(line: &[f32], spots: &mut [f32]) {
    let (quads, _) = line.as_chunks::<SIDE>();
    let len = quads.len();
    let (abc, def) = spots.split_at_mut(3 * len);
    let ((a, bc), (d, ef)) = (abc.split_at_mut(len), def.split_at_mut(len));
    let ((b, c), (e, f)) = (bc.split_at_mut(len), ef.split_at_mut(len));
    vectorize(
        #[inline(always)]
        || {
            let outputs = a.iter_mut().zip(b).zip(c).zip(d).zip(e).zip(f);
            for ((((((a, b), c), d), e), f), (x, y)) in outputs.zip(quads.iter().zip(&quads[1..])) {
                [*a, *b, *c, *d, *e, *f] = input_transform([x[0], x[1], x[2], x[3], y[0], y[1]]);
            }
        },
    );
}

/// Tiles whose outputs are computed side by side.
const LANES: usize = 16;

/// A^T from both sides of [`LANES`] tiles, plus `bias`, written as four lines of pixels.
#[inline(always)]
fn untransform(spots: [&[f32]; SPOTS], bias: f32, lines: [&mut [f32]; SIDE]) {
    let mut down = [[[0.0; LANES]; SIGHT]; SIDE];
    for column in 0..SIGHT {
        for lane in 0..LANES {
            let values = output_transform(std::array::from_fn(|line| spots[line * SIGHT + column][lane]));
            for (down, value) in down.iter_mut().zip(values) {
                down[column][lane] = value;
            }
        }
    }
    for (line, down) in lines.into_iter().zip(&down) {
        for (lane, quad) in line.as_chunks_mut::<SIDE>().0.iter_mut().enumerate().take(LANES) {
            *quad = output_transform(std::array::from_fn(|column| down[column][lane])).map(|value| value + bias);
        }
    }
}

/// G of three numbers.
#[inline(always)]
fn kernel_transform([x, y, z]: [f32; 3]) -> [f32; SIGHT] {
    // The reciprocals of what the polynomial x (x^2 - A^2) (x^2 - B^2) slopes by at 0, A and B.
    const ZERO: f32 = 1.0 / (AA * BB);
    const AT_A: f32 = 1.0 / (2.0 * AA * (AA - BB));
    const AT_B: f32 = 1.0 / (2.0 * BB * (BB - AA));
    let (even_a, odd_a) = (AT_A * x + AT_A * AA * z, AT_A * A * y);
    let (even_b, odd_b) = (AT_B * x + AT_B * BB * z, AT_B * B * y);
    [ZERO * x, even_a + odd_a, even_a - odd_a, even_b + odd_b, even_b - odd_b, z]
}

/// G from both sides of [`COLUMNS`] kernels, whose taps are the rows of `taps`.
#[inline(always)]
fn transform_taps(taps: &[f32; 9 * COLUMNS], direction: Direction, spots: &mut [[f32; COLUMNS]; SPOTS]) {
    for lane in 0..COLUMNS {
        let tap = |row: usize, column: usize| match direction {
            Direction::Forward => taps[(3 * row + column) * COLUMNS + lane],
            Direction::Backward => taps[(8 - 3 * row - column) * COLUMNS + lane],
        };
        let down: [[f32; SIGHT]; 3] =
            std::array::from_fn(|column| kernel_transform(std::array::from_fn(|row| tap(row, column))));
        for line in 0..SIGHT {
            let along = kernel_transform(std::array::from_fn(|column| down[column][line]));
            for (column, value) in along.into_iter().enumerate() {
                spots[line * SIGHT + column][lane] = value;
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
        transpose_into(&taps[9 * first..], 9, [columns.len(), 9], &mut panel, COLUMNS);
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
