//! Views of matrices in memory. They know where elements lie, not what they mean.
#![allow(unsafe_code)]

use std::marker::PhantomData;
use std::ops::Range;

/// A matrix to read: rows of contiguous elements, or columns of them once transposed.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f32],
    pub rows: usize,
    pub columns: usize,
    pub row_stride: usize,
    pub column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// The contiguous row-major matrix that starts at `values`.
    pub fn new(values: &'a [f32], rows: usize, columns: usize) -> Self {
        Matrix::strided(values, rows, columns, columns)
    }

    /// The matrix whose rows start `row_stride` elements apart.
    pub fn strided(values: &'a [f32], rows: usize, columns: usize, row_stride: usize) -> Self {
        let reach = if rows * columns == 0 {
            0
        } else {
            (rows - 1) * row_stride + columns
        };
        assert!(
            reach <= values.len(),
            "matrix: {rows}x{columns} reach beyond the values"
        );
        Matrix {
            values,
            rows,
            columns,
            row_stride,
            column_stride: 1,
        }
    }

    /// The rows of `range`.
    pub fn rows(self, range: Range<usize>) -> Self {
        assert!(
            range.start <= range.end && range.end <= self.rows,
            "matrix: no rows {range:?} in {}",
            self.rows
        );
        // Of no rows at all the start may lie beyond the end.
        let start = (range.start * self.row_stride).min(self.values.len());
        Matrix {
            values: &self.values[start..],
            rows: range.len(),
            ..self
        }
    }

    /// The columns of `range`.
    pub fn columns(self, range: Range<usize>) -> Self {
        self.transposed().rows(range).transposed()
    }

    /// The transpose, without a copy.
    pub fn transposed(self) -> Self {
        let Matrix {
            values,
            rows,
            columns,
            row_stride,
            column_stride,
        } = self;
        Matrix {
            values,
            rows: columns,
            columns: rows,
            row_stride: column_stride,
            column_stride: row_stride,
        }
    }

    /// One row of a matrix whose rows are contiguous.
    pub fn row(&self, row: usize) -> &'a [f32] {
        assert!(
            self.column_stride == 1 && row < self.rows,
            "matrix: no contiguous row {row} in {}",
            self.rows
        );
        &self.values[row * self.row_stride..][..self.columns]
    }

    /// The values from the first element on.
    pub fn values(&self) -> &'a [f32] {
        self.values
    }
}

/// A matrix to write: rows of contiguous elements, `row_stride` apart.
pub struct MatrixMut<'a> {
    start: *mut f32,
    rows: usize,
    columns: usize,
    row_stride: usize,
    borrow: PhantomData<&'a mut [f32]>,
}

impl<'a> MatrixMut<'a> {
    /// The contiguous row-major matrix that starts at `values`.
    pub fn new(values: &'a mut [f32], rows: usize, columns: usize) -> Self {
        // Its assertion is wanted, not the view.
        Matrix::new(values, rows, columns);
        MatrixMut {
            start: values.as_mut_ptr(),
            rows,
            columns,
            row_stride: columns,
            borrow: PhantomData,
        }
    }

    /// The rows of `columns` elements, `row_stride` apart, from `start` on.
    /// SAFETY: while it lives, nobody else reads or writes these elements.
    pub(super) unsafe fn from_start(
        start: *mut f32,
        [rows, columns]: [usize; 2],
        row_stride: usize,
    ) -> Self {
        MatrixMut {
            start,
            rows,
            columns,
            row_stride,
            borrow: PhantomData,
        }
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    pub fn row_stride(&self) -> usize {
        self.row_stride
    }

    /// Where the first element lies.
    pub fn start(&mut self) -> *mut f32 {
        self.start
    }

    /// The part of the rows and columns given.
    pub fn block(&mut self, rows: Range<usize>, columns: Range<usize>) -> MatrixMut<'_> {
        let inside = rows.start <= rows.end && columns.start <= columns.end;
        assert!(
            inside && rows.end <= self.rows && columns.end <= self.columns,
            "matrix: no rows {rows:?} or no columns {columns:?} in {}x{}",
            self.rows,
            self.columns
        );
        // Of no rows at all the start may lie beyond the end.
        let offset = if rows.is_empty() {
            0
        } else {
            rows.start * self.row_stride + columns.start
        };
        let extents = [rows.len(), columns.len()];
        // SAFETY: the block lies within the borrowed values, and `&mut self` keeps others from
        // being handed out.
        unsafe { MatrixMut::from_start(self.start.add(offset), extents, self.row_stride) }
    }

    /// The columns of this block in one row. Panics beyond the last row.
    pub fn row(&mut self, row: usize) -> &mut [f32] {
        assert!(row < self.rows, "matrix: no row {row} in {}", self.rows);
        // SAFETY: the row lies within the borrowed values, and `&mut self` keeps other rows from
        // being handed out.
        unsafe {
            std::slice::from_raw_parts_mut(self.start.add(row * self.row_stride), self.columns)
        }
    }
}
