//! A result cut into shares for several threads: which rows and columns each may write. It knows no
//! operation.
#![allow(unsafe_code)]

use std::marker::PhantomData;
use std::ops::Range;

use rayon::prelude::*;

use super::matrix::MatrixMut;

/// How a stack of equal matrices is cut into shares.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    pub matrices: usize,
    pub rows: usize,
    pub columns: usize,
    /// Columns of a panel; the last panel of a matrix may be narrower.
    pub panel: usize,
    /// Rows of a share.
    pub share_rows: usize,
    /// Panels of a share, counted through all matrices.
    pub share_panels: usize,
}

/// Some rows of some panels, which one task alone may write.
pub struct Share<'a> {
    start: *mut f32,
    pub cut: Cut,
    /// The rows of the share, in each matrix.
    pub rows: Range<usize>,
    /// The panels of the share, counted through all matrices.
    pub panels: Range<usize>,
    borrow: PhantomData<&'a mut [f32]>,
}

impl Cut {
    pub fn panels_per_matrix(&self) -> usize {
        self.columns.div_ceil(self.panel)
    }

    /// The matrix that a panel belongs to, and its columns there.
    pub fn columns_of(&self, panel: usize) -> (usize, Range<usize>) {
        let matrix = panel / self.panels_per_matrix();
        let first = panel % self.panels_per_matrix() * self.panel;
        (matrix, first..self.columns.min(first + self.panel))
    }

    /// Shares one below the other; those beside each other are [`Self::shares_across`].
    pub fn shares_down(&self) -> usize {
        self.rows.div_ceil(self.share_rows)
    }

    pub fn shares_across(&self) -> usize {
        (self.matrices * self.panels_per_matrix()).div_ceil(self.share_panels.max(1))
    }

    /// The number of shares of the stack that fills `out`.
    fn shares(&self, out: &[f32]) -> usize {
        assert_eq!(
            out.len(),
            self.matrices * self.rows * self.columns,
            "matrix: the stack does not fill its values"
        );
        // An extent of 0 would be divided by.
        if out.is_empty() {
            0
        } else {
            self.shares_down() * self.shares_across()
        }
    }

    /// Share number `index` of the stack that begins at `start`. No two shares have both a row and
    /// a panel in common.
    fn share(self, start: *mut f32, index: usize) -> Share<'static> {
        // Across first: neighbouring shares read the same rows of the left factor.
        let row = index / self.shares_across() * self.share_rows;
        let panel = index % self.shares_across() * self.share_panels;
        let rows = row..self.rows.min(row + self.share_rows);
        let panels =
            panel..(self.matrices * self.panels_per_matrix()).min(panel + self.share_panels);
        Share {
            start,
            cut: self,
            rows,
            panels,
            borrow: PhantomData,
        }
    }

    /// Hands every share of the stack that fills `out` to `kernel`, in parallel.
    pub fn for_each_share(self, out: &mut [f32], kernel: impl Fn(Share) + Sync) {
        let shares = self.shares(out);
        let start = Start(out.as_mut_ptr());
        (0..shares)
            .into_par_iter()
            .for_each(|index| kernel(self.share(start.get(), index)));
    }

    /// Hands every share to `kernel`, in parallel, and gathers what it returns in the order of the
    /// shares.
    pub fn map_shares<R: Send>(
        self,
        out: &mut [f32],
        kernel: impl Fn(Share) -> R + Sync,
    ) -> Vec<R> {
        let shares = self.shares(out);
        let start = Start(out.as_mut_ptr());
        (0..shares)
            .into_par_iter()
            .map(|index| kernel(self.share(start.get(), index)))
            .collect()
    }

    /// Hands every share to `kernel` on the calling thread, one after the other.
    pub fn for_each_share_alone(self, out: &mut [f32], mut kernel: impl FnMut(Share)) {
        let shares = self.shares(out);
        let start = out.as_mut_ptr();
        (0..shares).for_each(|index| kernel(self.share(start, index)));
    }
}

impl Share<'_> {
    /// Rows `rows` of the share, counted from its first, in one of its panels.
    pub fn block(&mut self, rows: Range<usize>, panel: usize) -> MatrixMut<'_> {
        let inside = rows.start <= rows.end && rows.end <= self.rows.len();
        assert!(
            inside && self.panels.contains(&panel),
            "matrix: rows {rows:?} of panel {panel} are no part of a share"
        );
        let (matrix, columns) = self.cut.columns_of(panel);
        let row = matrix * self.cut.rows + self.rows.start + rows.start;
        let offset = row * self.cut.columns + columns.start;
        let extents = [rows.len(), columns.len()];
        // SAFETY: the block lies within the stack and the share, whose values no other task may
        // touch; `&mut self` keeps other blocks from being handed out.
        unsafe { MatrixMut::from_start(self.start.add(offset), extents, self.cut.columns) }
    }

    /// One row of the share in each of `matrices`, which have a single panel: as the rows of one
    /// matrix.
    pub fn through(&mut self, row: usize, matrices: Range<usize>) -> MatrixMut<'_> {
        let inside = matrices.start >= self.panels.start && matrices.end <= self.panels.end;
        assert!(
            inside && row < self.rows.len() && self.cut.panels_per_matrix() == 1,
            "matrix: row {row} of {matrices:?} is no part of a share"
        );
        let first = matrices.start * self.cut.rows + self.rows.start + row;
        let offset = first * self.cut.columns;
        let extents = [matrices.len(), self.cut.columns];
        let row_stride = self.cut.rows * self.cut.columns;
        // SAFETY: every row lies within the stack and the share, whose values no other task may
        // touch; `&mut self` keeps other blocks from being handed out.
        unsafe { MatrixMut::from_start(self.start.add(offset), extents, row_stride) }
    }
}

/// The start of values that several threads write to, each to its own.
struct Start(*mut f32);

impl Start {
    fn get(&self) -> *mut f32 {
        self.0
    }
}

// SAFETY: the pointer is only read here; who writes through it, and where, is settled by `Share`.
unsafe impl Sync for Start {}
