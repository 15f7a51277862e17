//! Products of matrices: packed panels of the right factor meet tiles of the left one, share by
//! share. It knows how work is cut, not where factors come from.

use super::bf16;
use super::buffer::Buffer;
use super::factor::{DEPTH, Left, Right, TILE, TILE_STRIDE};
use super::matrix::{Cut, Matrix, MatrixMut, Share};
use super::simd::vectorize;
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use crate::weight::Precision;

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
    precision: Precision,
) -> Buffer {
    let mut out = Buffer::stale(matrices * rows * columns);
    let compute = |mut share: Share| {
        let old = begin(&mut share, start);
        add_product(&mut share, left, right, depth, (old, precision));
    };
    let cut = cut([matrices, rows, columns]);
    if out.len() * depth <= ALONE {
        cut.for_each_share_alone(&mut out, compute);
    } else {
        cut.for_each_share(&mut out, compute);
    }
    out
}

/// Shares of at most 256 columns and of as many rows as leave enough tasks: fewer columns first,
/// since a share packs its columns for all of its rows.
pub fn cut([matrices, rows, columns]: [usize; 3]) -> Cut {
    let panels = (matrices * columns.div_ceil(COLUMNS)).max(1);
    let share_panels = (panels / TASKS).clamp(2, PANELS);
    let down = TASKS.div_ceil(panels.div_ceil(share_panels));
    let share_rows = rows
        .div_ceil(down)
        .next_multiple_of(ROWS)
        .clamp(FEWEST_ROWS, MOST_ROWS);
    Cut {
        matrices,
        rows,
        columns,
        panel: COLUMNS,
        share_rows,
        share_panels,
    }
}

/// Fills a share with what its sums start from, unless that is nothing.
pub fn begin(share: &mut Share, start: Start) -> Old {
    let rows = share.rows.clone();
    let cut = share.cut;
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
pub fn add_product(
    share: &mut Share,
    left: &impl Left,
    right: &impl Right,
    depth: usize,
    (old, precision): (Old, Precision),
) {
    let rows = share.rows.clone();
    let cut = share.cut;
    let mut panels = Buffer::stale(share.panels.len() * DEPTH.min(depth) * COLUMNS);
    let mut spaces = [[0.0; TILE]; 2];
    for first in (0..depth).step_by(DEPTH) {
        let steps = first..depth.min(first + DEPTH);
        let old = if first == 0 { old } else { Old::Keep };
        let panels = &mut panels[..share.panels.len() * steps.len() * COLUMNS];
        for start in steps.clone().step_by(right.grain()) {
            let grain = start..steps.end.min(start + right.grain());
            for (panel, packed) in share
                .panels
                .clone()
                .zip(panels.chunks_mut(steps.len() * COLUMNS))
            {
                let (matrix, columns) = cut.columns_of(panel);
                let packed = &mut packed[(start - first) * COLUMNS..][..grain.len() * COLUMNS];
                right.pack(matrix, columns, grain.clone(), packed);
            }
        }
        panels
            .chunks_mut(steps.len() * COLUMNS)
            .for_each(|packed| narrow_panel(packed, precision));
        for row in (0..rows.len()).step_by(ROWS) {
            let tile = row..rows.len().min(row + ROWS);
            let [space, narrow] = &mut spaces;
            let left = left.tile(
                rows.start + tile.start..rows.start + tile.end,
                steps.clone(),
                space,
            );
            let left = narrow_tile(left, narrow, precision);
            for (panel, packed) in share
                .panels
                .clone()
                .zip(panels.chunks(steps.len() * COLUMNS))
            {
                multiply_tile(
                    &mut share.block(tile.clone(), panel),
                    left,
                    packed,
                    (old, precision),
                );
            }
        }
    }
}

/// In bf16, a panel becomes half as many rows of pairs, in place.
fn narrow_panel(panel: &mut [f32], precision: Precision) {
    if precision == Precision::F32 {
        return;
    }
    vectorize(
        #[inline(always)]
        || {
            for row in 0..(panel.len() / COLUMNS).div_ceil(2) {
                let lower = 2 * row * COLUMNS;
                let upper = (2 * row + 1) * COLUMNS;
                for column in 0..COLUMNS {
                    let upper = if upper < panel.len() {
                        panel[upper + column]
                    } else {
                        0.0
                    };
                    panel[row * COLUMNS + column] = bf16::pair(panel[lower + column], upper);
                }
            }
        },
    );
}

/// In bf16, a tile becomes one of pairs, in `space`, with half as many columns.
fn narrow_tile<'a>(tile: Matrix<'a>, space: &'a mut [f32], precision: Precision) -> Matrix<'a> {
    if precision == Precision::F32 {
        return tile;
    }
    let row_stride = tile.row_stride;
    let step = tile.column_stride;
    let columns = tile.columns;
    let values = tile.values();
    vectorize(
        #[inline(always)]
        || {
            for (row, space) in space.chunks_mut(TILE_STRIDE).enumerate().take(tile.rows) {
                for (k, space) in space.iter_mut().enumerate().take(columns.div_ceil(2)) {
                    let at = row * row_stride + 2 * k * step;
                    let upper = if 2 * k + 1 < columns {
                        values[at + step]
                    } else {
                        0.0
                    };
                    *space = bf16::pair(values[at], upper);
                }
            }
        },
    );
    Matrix::strided(space, tile.rows, columns.div_ceil(2), TILE_STRIDE)
}

/// A right factor packed once, to meet several left factors.
pub struct Packed {
    /// For each range of [`DEPTH`] steps, its panels.
    values: Buffer,
    depth: usize,
    columns: usize,
    precision: Precision,
}

impl Packed {
    pub fn new(right: &impl Right, depth: usize, columns: usize, precision: Precision) -> Packed {
        let panels = columns.div_ceil(COLUMNS);
        let mut values = Buffer::stale(depth * panels * COLUMNS);
        for (i, values) in values.chunks_mut(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..depth.min((i + 1) * DEPTH);
            for (panel, packed) in values.chunks_mut(steps.len() * COLUMNS).enumerate() {
                let range = panel * COLUMNS..columns.min((panel + 1) * COLUMNS);
                right.pack(0, range, steps.clone(), packed);
                narrow_panel(packed, precision);
            }
        }
        Packed {
            values,
            depth,
            columns,
            precision,
        }
    }

    /// Writes `left` times this factor to `out`, a contiguous matrix of `rows` rows, on the calling
    /// thread.
    pub fn multiply(&self, out: &mut [f32], rows: usize, left: &impl Left, old: Old) {
        let panels = self.columns.div_ceil(COLUMNS);
        let mut out = MatrixMut::new(out, rows, self.columns);
        let mut spaces = [[0.0; TILE]; 2];
        for (i, values) in self.values.chunks(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..self.depth.min((i + 1) * DEPTH);
            let old = if i == 0 { old } else { Old::Keep };
            for row in (0..rows).step_by(ROWS) {
                let tile = row..rows.min(row + ROWS);
                let [space, narrow] = &mut spaces;
                let left = narrow_tile(
                    left.tile(tile.clone(), steps.clone(), space),
                    narrow,
                    self.precision,
                );
                for (panel, packed) in values.chunks(steps.len() * COLUMNS).enumerate() {
                    let columns = panel * COLUMNS..self.columns.min((panel + 1) * COLUMNS);
                    multiply_tile(
                        &mut out.block(tile.clone(), columns),
                        left,
                        packed,
                        (old, self.precision),
                    );
                }
            }
        }
    }
}
