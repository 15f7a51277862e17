//! Products of matrices: packed panels of the right factor meet tiles of the left one. Both factors say for themselves
//! how they are read, so neither an image's patches nor a widened weight ever exists as a whole.

use std::ops::Range;

use super::buffer::Buffer;
use super::matrix::{Cut, Matrix, MatrixMut, Share};
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use super::transpose::transpose_into;
use super::weight::Values;

/// Steps of the inner sum per packed panel: a panel and a tile's rows stay in the first cache.
pub const DEPTH: usize = 256;
/// Panels per task: packed, they stay in the second cache.
const PANELS: usize = 8;
/// Tasks are made smaller until there are about so many, whatever the number of threads.
const TASKS: usize = 16;
/// The fewest rows of a task: enough to make packing cheap.
const FEWEST_ROWS: usize = 8 * ROWS;
/// The most rows of a task.
const MOST_ROWS: usize = 64 * ROWS;
/// Multiplications that one thread does sooner than it wakes others.
const ALONE: usize = 1 << 21;
/// Elements between the rows of a packed tile; not a multiple of a page, so that they do not crowd one cache set.
const TILE_STRIDE: usize = DEPTH + 16;
/// Elements of a packed tile.
const TILE: usize = ROWS * TILE_STRIDE;

/// The left factor.
pub trait Left: Sync {
    /// The part `rows`, `depth`, copied to `space` or borrowed.
    fn tile<'a>(&'a self, rows: Range<usize>, depth: Range<usize>, space: &'a mut [f32]) -> Matrix<'a>;
}

/// The right factor: one matrix, or one for each matrix of the result.
pub trait Right: Sync {
    /// Writes rows `depth` of at most [`COLUMNS`] columns to `panel`, whose rows have [`COLUMNS`] elements. What lies
    /// beyond the columns may stay as it is: it meets no column of the result.
    fn pack(&self, matrix: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]);
}

/// What the sums start from.
#[derive(Clone, Copy)]
pub enum Start<'a> {
    Zero,
    /// One number for each row.
    Rows(&'a [f32]),
    /// One number for each column.
    Columns(&'a [f32]),
}

/// For each of `matrices` results `[rows, columns]`: `start + left right`, summed over `depth`.
pub fn product(
    [matrices, rows, columns]: [usize; 3],
    depth: usize,
    left: &impl Left,
    right: &impl Right,
    start: Start,
) -> Buffer {
    let mut out = Buffer::stale(matrices * rows * columns);
    let compute = |mut share: Share| {
        let old = begin(&mut share, start);
        add_product(&mut share, left, right, depth, old);
    };
    let cut = cut([matrices, rows, columns]);
    if out.len() * depth <= ALONE {
        cut.for_each_share_alone(&mut out, compute);
    } else {
        cut.for_each_share(&mut out, compute);
    }
    out
}

/// Shares of 256 columns and of as many rows as leave enough tasks; of fewer columns where there are few rows.
pub fn cut([matrices, rows, columns]: [usize; 3]) -> Cut {
    let panels = (matrices * columns.div_ceil(COLUMNS)).max(1);
    let share_panels = PANELS.min(panels);
    let down = TASKS.div_ceil(panels.div_ceil(share_panels));
    let share_rows = rows.div_ceil(down).next_multiple_of(ROWS).clamp(FEWEST_ROWS, MOST_ROWS);
    let tasks = panels.div_ceil(share_panels) * rows.div_ceil(share_rows);
    let share_panels = (share_panels * tasks.min(TASKS) / TASKS).max(1);
    Cut { matrices, rows, columns, panel: COLUMNS, share_rows, share_panels }
}

/// Fills a share with what its sums start from, unless that is nothing.
pub fn begin(share: &mut Share, start: Start) -> Old {
    let (rows, cut) = (share.rows.clone(), share.cut);
    for panel in share.panels.clone() {
        let (_, columns) = cut.columns_of(panel);
        let mut block = share.block(0..rows.len(), panel);
        for row in 0..rows.len() {
            match start {
                Start::Zero => return Old::Forget,
                Start::Rows(values) => block.row(row).fill(values[rows.start + row]),
                Start::Columns(values) => block.row(row).copy_from_slice(&values[columns.clone()]),
            }
        }
    }
    Old::Keep
}

/// Writes the product to a share of the result, on the calling thread.
pub fn add_product(share: &mut Share, left: &impl Left, right: &impl Right, depth: usize, old: Old) {
    let (rows, cut) = (share.rows.clone(), share.cut);
    let mut panels = Buffer::stale(share.panels.len() * DEPTH.min(depth) * COLUMNS);
    let mut space = [0.0; TILE];
    for first in (0..depth).step_by(DEPTH) {
        let steps = first..depth.min(first + DEPTH);
        let old = if first == 0 { old } else { Old::Keep };
        let panels = &mut panels[..share.panels.len() * steps.len() * COLUMNS];
        for (panel, packed) in share.panels.clone().zip(panels.chunks_mut(steps.len() * COLUMNS)) {
            let (matrix, columns) = cut.columns_of(panel);
            right.pack(matrix, columns, steps.clone(), packed);
        }
        for row in (0..rows.len()).step_by(ROWS) {
            let tile = row..rows.len().min(row + ROWS);
            let left = left.tile(rows.start + tile.start..rows.start + tile.end, steps.clone(), &mut space);
            for (panel, packed) in share.panels.clone().zip(panels.chunks(steps.len() * COLUMNS)) {
                multiply_tile(&mut share.block(tile.clone(), panel), left, packed, old);
            }
        }
    }
}

/// A right factor packed once, to meet several left factors.
pub struct Packed {
    /// For each range of [`DEPTH`] steps, its panels.
    values: Buffer,
    depth: usize,
    columns: usize,
}

impl Packed {
    pub fn new(right: &impl Right, depth: usize, columns: usize) -> Packed {
        let panels = columns.div_ceil(COLUMNS);
        let mut values = Buffer::stale(depth * panels * COLUMNS);
        for (i, values) in values.chunks_mut(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..depth.min((i + 1) * DEPTH);
            for (panel, packed) in values.chunks_mut(steps.len() * COLUMNS).enumerate() {
                let range = panel * COLUMNS..columns.min((panel + 1) * COLUMNS);
                right.pack(0, range, steps.clone(), packed);
            }
        }
        Packed { values, depth, columns }
    }

    /// Writes `left` times this factor to `out`, a contiguous matrix of `rows` rows, on the calling thread.
    pub fn multiply(&self, out: &mut [f32], rows: usize, left: &impl Left, old: Old) {
        let panels = self.columns.div_ceil(COLUMNS);
        let mut out = MatrixMut::new(out, rows, self.columns);
        let mut space = [0.0; TILE];
        for (i, values) in self.values.chunks(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..self.depth.min((i + 1) * DEPTH);
            let old = if i == 0 { old } else { Old::Keep };
            for row in (0..rows).step_by(ROWS) {
                let tile = row..rows.min(row + ROWS);
                let left = left.tile(tile.clone(), steps.clone(), &mut space);
                for (panel, packed) in values.chunks(steps.len() * COLUMNS).enumerate() {
                    let columns = panel * COLUMNS..self.columns.min((panel + 1) * COLUMNS);
                    multiply_tile(&mut out.block(tile.clone(), columns), left, packed, old);
                }
            }
        }
    }
}

impl Left for Matrix<'_> {
    fn tile<'a>(&'a self, rows: Range<usize>, depth: Range<usize>, space: &'a mut [f32]) -> Matrix<'a> {
        let part = self.rows(rows).columns(depth);
        if part.column_stride == 1 {
            for (row, space) in space.chunks_mut(TILE_STRIDE).enumerate().take(part.rows) {
                space[..part.columns].copy_from_slice(part.row(row));
            }
            return Matrix::strided(space, part.rows, part.columns, TILE_STRIDE);
        }
        let turned = part.transposed();
        for (k, space) in space.chunks_mut(ROWS).enumerate().take(part.columns) {
            space[..part.rows].copy_from_slice(turned.row(k));
        }
        Matrix::strided(space, part.columns, part.rows, ROWS).transposed()
    }
}

impl Right for Matrix<'_> {
    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        let part = self.rows(depth).columns(columns);
        if part.column_stride == 1 {
            for (k, panel) in panel.chunks_mut(COLUMNS).enumerate() {
                panel[..part.columns].copy_from_slice(part.row(k));
            }
        } else {
            transpose_into(part.values(), part.column_stride, [part.columns, part.rows], panel, COLUMNS);
        }
    }
}

/// The weight `[rows, columns]` of a linear layer, in any format.
#[derive(Clone, Copy)]
pub struct Stored<'a> {
    pub values: Values<'a>,
    pub columns: usize,
}

impl Left for Stored<'_> {
    fn tile<'a>(&'a self, rows: Range<usize>, depth: Range<usize>, space: &'a mut [f32]) -> Matrix<'a> {
        for (row, space) in rows.clone().zip(space.chunks_mut(TILE_STRIDE)) {
            self.values.widen(row * self.columns + depth.start, &mut space[..depth.len()]);
        }
        Matrix::strided(space, rows.len(), depth.len(), TILE_STRIDE)
    }
}

impl Right for Stored<'_> {
    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        for (k, panel) in depth.zip(panel.chunks_mut(COLUMNS)) {
            self.values.widen(k * self.columns + columns.start, &mut panel[..columns.len()]);
        }
    }
}

/// The transpose of a [`Stored`] weight, which has `columns` elements in each of its own rows.
#[derive(Clone, Copy)]
pub struct Turned<'a>(pub Stored<'a>);

impl Left for Turned<'_> {
    fn tile<'a>(&'a self, rows: Range<usize>, depth: Range<usize>, space: &'a mut [f32]) -> Matrix<'a> {
        for (k, space) in depth.clone().zip(space.chunks_mut(ROWS)) {
            self.0.values.widen(k * self.0.columns + rows.start, &mut space[..rows.len()]);
        }
        Matrix::strided(space, depth.len(), rows.len(), ROWS).transposed()
    }
}

impl Right for Turned<'_> {
    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        if let Values::F32(values) = self.0.values {
            let rows = &values[columns.start * self.0.columns + depth.start..];
            return transpose_into(rows, self.0.columns, [columns.len(), depth.len()], panel, COLUMNS);
        }
        let mut rows = [0.0; COLUMNS * DEPTH];
        for (column, row) in columns.clone().zip(rows.chunks_mut(DEPTH)) {
            self.0.values.widen(column * self.0.columns + depth.start, &mut row[..depth.len()]);
        }
        transpose_into(&rows, DEPTH, [columns.len(), depth.len()], panel, COLUMNS);
    }
}
