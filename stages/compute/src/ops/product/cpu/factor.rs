//! The factors of products. Each says for itself how it is read, piece by piece, so that neither an
//! image's patches nor a widened weight ever exists as a whole.

use std::ops::Range;

use super::tile::{COLUMNS, ROWS};
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::simd::prefetch;
use crate::runtime::cpu::transpose::transpose_into;
use crate::runtime::cpu::values::Values;

/// Steps of the inner sum per packed panel: a panel and a tile's rows stay in the first cache.
pub const DEPTH: usize = 256;
/// Elements between the rows of a packed tile; not a multiple of a page, so that they do not crowd
/// one cache set.
pub const TILE_STRIDE: usize = DEPTH + 16;
/// Elements of a packed tile.
pub const TILE: usize = ROWS * TILE_STRIDE;

/// Elements of a page of memory, beyond which no processor guesses what is read next.
const PAGE: usize = 1024;

/// Rows that are packed for all panels together, if nothing speaks against it.
pub const GRAIN: usize = 32;

/// The left factor of a product, which hands itself out in tiles of rows.
pub trait Left: Sync {
    /// The part `rows`, `depth`, copied to `space` or borrowed.
    fn tile<'a>(
        &'a self,
        rows: Range<usize>,
        depth: Range<usize>,
        space: &'a mut [f32],
    ) -> Matrix<'a>;
}

/// The right factor: one matrix, or one for each matrix of the result.
pub trait Right: Sync {
    /// Rows to pack for all panels of a task before the next rows: few where neighbouring panels
    /// read neighbouring memory of far-apart rows. A multiple of 16.
    fn grain(&self) -> usize {
        GRAIN
    }

    /// What packing a number costs, in copies of one of a left factor.
    fn packing(&self) -> usize {
        1
    }

    /// Writes rows `depth` of at most [`COLUMNS`] columns to `panel`, whose rows have [`COLUMNS`]
    /// elements. What lies beyond the columns may stay as it is: it meets no column of the result.
    fn pack(&self, matrix: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]);
}

impl Left for Matrix<'_> {
    fn tile<'a>(
        &'a self,
        rows: Range<usize>,
        depth: Range<usize>,
        space: &'a mut [f32],
    ) -> Matrix<'a> {
        let ahead = self.rows.min(rows.end)..self.rows.min(rows.end + ROWS);
        let part = self.rows(rows).columns(depth.clone());
        // Copied although it lies well: rows far apart in memory would crowd one cache set.
        if part.column_stride == 1 {
            for (row, space) in space.chunks_mut(TILE_STRIDE).enumerate().take(part.rows) {
                space[..part.columns].copy_from_slice(part.row(row));
            }
            // The next tile's rows are prefetched while this one is multiplied. Rows within a page
            // the processor prefetches by itself.
            if self.row_stride > PAGE {
                ahead.for_each(|row| prefetch(&self.row(row)[depth.clone()]));
            }
            return Matrix::strided(space, part.rows, part.columns, TILE_STRIDE);
        }
        // Columns lie side by side, so they are copied, and read as the transpose.
        let turned = part.transposed();
        for (k, space) in space.chunks_mut(ROWS).enumerate().take(part.columns) {
            space[..part.rows].copy_from_slice(turned.row(k));
        }
        Matrix::strided(space, part.columns, part.rows, ROWS).transposed()
    }
}

impl Right for Matrix<'_> {
    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        let part = self.rows(depth.clone()).columns(columns.clone());
        if part.column_stride == 1 {
            for (k, panel) in panel.chunks_mut(COLUMNS).enumerate() {
                let ahead = depth.start + k + GRAIN;
                if ahead < self.rows {
                    prefetch(&self.row(ahead)[columns.clone()]);
                }
                panel[..part.columns].copy_from_slice(part.row(k));
            }
        } else {
            transpose_into(
                part.values(),
                part.column_stride,
                [part.columns, part.rows],
                panel,
                COLUMNS,
            );
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
    fn tile<'a>(
        &'a self,
        rows: Range<usize>,
        depth: Range<usize>,
        space: &'a mut [f32],
    ) -> Matrix<'a> {
        for (row, space) in rows.clone().zip(space.chunks_mut(TILE_STRIDE)) {
            let first = row * self.columns + depth.start;
            self.values.widen(first, &mut space[..depth.len()]);
            // The next tile's rows are prefetched while this one is multiplied. Rows within a page
            // the processor prefetches by itself.
            if self.columns > PAGE {
                let ahead = first + ROWS * self.columns;
                self.values.prefetch(ahead..ahead + depth.len());
            }
        }
        Matrix::strided(space, rows.len(), depth.len(), TILE_STRIDE)
    }
}

impl Right for Stored<'_> {
    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        for (k, panel) in depth.zip(panel.chunks_mut(COLUMNS)) {
            // Of rows far apart a share reads so little that no processor guesses the next grain.
            let ahead = (k + GRAIN) * self.columns + columns.start;
            self.values.prefetch(ahead..ahead + columns.len());
            self.values.widen(
                k * self.columns + columns.start,
                &mut panel[..columns.len()],
            );
        }
    }
}

/// The transpose of a [`Stored`] weight, which has `columns` elements in each of its own rows.
#[derive(Clone, Copy)]
pub struct Turned<'a>(pub Stored<'a>);

impl Left for Turned<'_> {
    fn tile<'a>(
        &'a self,
        rows: Range<usize>,
        depth: Range<usize>,
        space: &'a mut [f32],
    ) -> Matrix<'a> {
        for (k, space) in depth.clone().zip(space.chunks_mut(ROWS)) {
            self.0
                .values
                .widen(k * self.0.columns + rows.start, &mut space[..rows.len()]);
        }
        Matrix::strided(space, depth.len(), rows.len(), ROWS).transposed()
    }
}

impl Right for Turned<'_> {
    // Columns are rows of the weight, each of which lies in one piece along the depth.
    fn grain(&self) -> usize {
        DEPTH
    }

    fn packing(&self) -> usize {
        2
    }

    fn pack(&self, _: usize, columns: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        // Numbers of 32 bits are turned from where they lie.
        if let Values::F32(values) = self.0.values {
            let rows = &values[columns.start * self.0.columns + depth.start..];
            return transpose_into(
                rows,
                self.0.columns,
                [columns.len(), depth.len()],
                panel,
                COLUMNS,
            );
        }
        let mut rows = [0.0; COLUMNS * DEPTH];
        for (column, row) in columns.clone().zip(rows.chunks_mut(DEPTH)) {
            self.0.values.widen(
                column * self.0.columns + depth.start,
                &mut row[..depth.len()],
            );
        }
        transpose_into(&rows, DEPTH, [columns.len(), depth.len()], panel, COLUMNS);
    }
}
