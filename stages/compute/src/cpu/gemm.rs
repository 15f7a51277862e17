//! Strided matrices and their product, by the `gemm` crate. The one place where its unsafe interface is called.
#![allow(unsafe_code)]

use std::marker::PhantomData;
use std::ops::Range;

use gemm::Parallelism;
use rayon::prelude::*;

/// A matrix to read: rows of contiguous elements, or columns of them once transposed.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// The contiguous row-major matrix that starts at `values`.
    pub fn new(values: &'a [f32], rows: usize, columns: usize) -> Self {
        Matrix::strided(values, rows, columns, columns)
    }

    /// The matrix whose rows start `row_stride` elements apart.
    pub fn strided(values: &'a [f32], rows: usize, columns: usize, row_stride: usize) -> Self {
        let reach = if rows * columns == 0 { 0 } else { (rows - 1) * row_stride + columns };
        assert!(reach <= values.len(), "gemm: a {rows}x{columns} matrix reaches beyond its values");
        Matrix { values, rows, columns, row_stride, column_stride: 1 }
    }

    /// The rows of `range`.
    pub fn rows(self, range: Range<usize>) -> Self {
        assert!(range.start <= range.end && range.end <= self.rows, "gemm: no rows {range:?} in {}", self.rows);
        let start = (range.start * self.row_stride).min(self.values.len());
        Matrix { values: &self.values[start..], rows: range.len(), ..self }
    }

    /// The columns of `range`.
    pub fn columns(self, range: Range<usize>) -> Self {
        self.transposed().rows(range).transposed()
    }

    /// The same values read the other way.
    pub fn transposed(self) -> Self {
        let Matrix { values, rows, columns, row_stride, column_stride } = self;
        Matrix { values, rows: columns, columns: rows, row_stride: column_stride, column_stride: row_stride }
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
        MatrixMut::strided(values, rows, columns, columns)
    }

    /// The matrix whose rows start `row_stride` elements apart.
    pub fn strided(values: &'a mut [f32], rows: usize, columns: usize, row_stride: usize) -> Self {
        Matrix::strided(values, rows, columns, row_stride);
        MatrixMut { start: values.as_mut_ptr(), rows, columns, row_stride, borrow: PhantomData }
    }

    /// The number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The part of the rows and columns given.
    pub fn block(&mut self, rows: Range<usize>, columns: Range<usize>) -> MatrixMut<'_> {
        let inside = rows.start <= rows.end && columns.start <= columns.end;
        assert!(
            inside && rows.end <= self.rows && columns.end <= self.columns,
            "gemm: no rows {rows:?} or no columns {columns:?} in {}x{}",
            self.rows,
            self.columns
        );
        let offset = if rows.is_empty() { 0 } else { rows.start * self.row_stride + columns.start };
        // SAFETY: the block lies within the borrowed values, and `&mut self` keeps others from being handed out.
        let start = unsafe { self.start.add(offset) };
        MatrixMut { start, rows: rows.len(), columns: columns.len(), row_stride: self.row_stride, borrow: PhantomData }
    }

    /// One row.
    pub fn row(&mut self, row: usize) -> &mut [f32] {
        assert!(row < self.rows, "gemm: no row {row} in {}", self.rows);
        // SAFETY: the row lies within the borrowed values, and `&mut self` keeps other rows from being handed out.
        unsafe { std::slice::from_raw_parts_mut(self.start.add(row * self.row_stride), self.columns) }
    }
}

/// Who shares the work of one product.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// The calling thread alone.
    One,
    /// All threads of the current pool. The product is split over rows and columns only, so its bits stay the same.
    All,
}

/// `out = a b`, or `out += a b` if `accumulate`.
pub fn multiply(out: &mut MatrixMut, a: Matrix, b: Matrix, accumulate: bool, threads: Threads) {
    let (m, k, n) = (a.rows, a.columns, b.columns);
    assert!(b.rows == k && out.rows == m && out.columns == n, "gemm: the extents disagree");
    let parallelism = match threads {
        Threads::One => Parallelism::None,
        Threads::All => Parallelism::Rayon(0),
    };
    // SAFETY: `Matrix` and `MatrixMut` were checked against their values when they were made, the extents agree, and
    // `out` is borrowed exclusively.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.start,
            1,
            out.row_stride as isize,
            accumulate,
            a.values.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.values.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism,
        );
    }
}

/// Cuts each of the matrices `[rows, columns]` stacked in `out` into blocks of `width` columns, and hands every block
/// out in parallel: `kernel(matrix, first column, block)`.
pub fn column_blocks<K>(out: &mut [f32], [rows, columns]: [usize; 2], width: usize, kernel: K)
where
    K: Fn(usize, usize, MatrixMut) + Sync,
{
    if out.is_empty() {
        return;
    }
    let blocks = columns.div_ceil(width);
    let matrices = out.len() / (rows * columns);
    let start = Start(out.as_mut_ptr());
    (0..matrices * blocks).into_par_iter().for_each(|task| {
        let (matrix, first) = (task / blocks, task % blocks * width);
        // SAFETY: the block lies within `out`, and no two tasks share a matrix and a column.
        let start = unsafe { start.at(matrix * rows * columns + first) };
        let columns_here = width.min(columns - first);
        let block = MatrixMut { start, rows, columns: columns_here, row_stride: columns, borrow: PhantomData };
        kernel(matrix, first, block);
    });
}

/// The start of values that several threads write to, each to its own.
struct Start(*mut f32);

impl Start {
    /// SAFETY: `offset` must lie within the values.
    unsafe fn at(&self, offset: usize) -> *mut f32 {
        // SAFETY: by the contract of this function.
        unsafe { self.0.add(offset) }
    }
}

// SAFETY: the pointer is only read here; who writes through it, and where, is settled by `column_blocks`.
unsafe impl Sync for Start {}
