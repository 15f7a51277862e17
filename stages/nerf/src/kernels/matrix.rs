//! Products of tall matrices (one row per sample) with small ones. Knows nothing of what the rows
//! mean.
//!
//! Everything is row-major. Rows come in multiples of [`ROWS`], columns in multiples of
//! [`COLUMNS`]; callers pad. Vectors run along columns, so each output element is one chain of
//! fused multiply-adds in order of the inner index. Of a matrix with longer rows than a product
//! needs, the rest is not looked at.

use pulp::{Arch, Simd, WithSimd};

/// Rows of a register tile: row counts are multiples of it.
pub const ROWS: usize = 8;
/// Floats of the widest vector: column counts are multiples of it.
pub const COLUMNS: usize = 16;
/// Rows whose activations stay in the first-level cache while a weight gradient is summed.
const ROW_BLOCK: usize = 64;

/// A matrix to be read.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    /// All elements, row after row.
    pub values: &'a [f32],
    /// Numbers in a row.
    pub width: usize,
}

impl<'a> Matrix<'a> {
    /// Values, and how many of them make a row.
    pub fn new(values: &'a [f32], width: usize) -> Self {
        assert!(
            values.len().is_multiple_of(width),
            "matrix: {} values in rows of {width}",
            values.len()
        );
        Self { values, width }
    }

    /// How many whole rows the values make.
    pub fn rows(&self) -> usize {
        self.values.len() / self.width
    }
}

/// What a product is added to.
#[derive(Clone, Copy)]
pub enum Prologue {
    /// The output is overwritten.
    Zero,
    /// The output is added to.
    Add,
}

/// What happens to a product on its way to memory.
#[derive(Clone, Copy)]
pub enum Epilogue<'a> {
    /// It is stored as it is.
    Keep,
    /// max(x, 0), element by element.
    Relu,
    /// The backward pass of `Relu`: zero where this output of it was zero.
    ReluBackward(&'a [f32]),
}

/// c[n, m] = epilogue(prologue + a[n, k] b[k, m]) for `shape` = [k, m].
pub fn product(
    c: &mut [f32],
    a: Matrix<'_>,
    b: Matrix<'_>,
    shape: [usize; 2],
    prologue: Prologue,
    epilogue: Epilogue<'_>,
) {
    let [inner, columns] = shape;
    assert!(
        columns.is_multiple_of(COLUMNS) && b.width.is_multiple_of(COLUMNS),
        "product: columns {shape:?}"
    );
    assert!(
        inner <= a.width.min(b.rows()) && columns <= b.width,
        "product: {shape:?} of {} x {}",
        a.width,
        b.width
    );
    assert!(
        c.len() == a.rows() * columns && a.rows().is_multiple_of(ROWS),
        "product: {} rows",
        a.rows()
    );
    Arch::new().dispatch(Product {
        c,
        a,
        b,
        shape,
        prologue,
        epilogue,
    });
}

struct Product<'a> {
    c: &'a mut [f32],
    a: Matrix<'a>,
    b: Matrix<'a>,
    shape: [usize; 2],
    prologue: Prologue,
    epilogue: Epilogue<'a>,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // The usual widths as constants: then rows need no pointers of their own.
        match self.a.width {
            16 => self.with_rows_of(simd, 16),
            32 => self.with_rows_of(simd, 32),
            64 => self.with_rows_of(simd, 64),
            width => self.with_rows_of(simd, width),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn with_rows_of<S: Simd>(self, simd: S, width: usize) {
        // R x V sums, V vectors of b and one of a must fit into the registers: 16 + 4 + 1 of 32, or
        // 8 + 2 + 1 of 16. A taller tile reads b less often, a wider one a.
        match self.shape[1] / S::F32_LANES {
            n if n.is_multiple_of(4) && S::REGISTER_COUNT >= 32 => {
                self.tiles::<S, 4, 4>(simd, width)
            }
            n if n.is_multiple_of(2) && S::REGISTER_COUNT >= 32 => {
                self.tiles::<S, 8, 2>(simd, width)
            }
            n if n.is_multiple_of(2) => self.tiles::<S, 4, 2>(simd, width),
            _ => self.tiles::<S, 8, 1>(simd, width),
        }
    }

    #[inline(always)]
    fn tiles<S: Simd, const R: usize, const V: usize>(self, simd: S, a_width: usize) {
        let [inner, columns] = self.shape;
        let width = columns / S::F32_LANES;
        let b = S::as_simd_f32s(self.b.values)
            .0
            .chunks_exact(self.b.width / S::F32_LANES)
            .take(inner);
        let rows = self
            .c
            .chunks_exact_mut(R * columns)
            .zip(self.a.values.chunks_exact(R * a_width));
        for (tile, (c, a)) in rows.enumerate() {
            let c = S::as_mut_simd_f32s(c).0;
            for first in (0..width).step_by(V) {
                let mut sum: [[S::f32s; V]; R] = start(simd, c, width, first, self.prologue);
                add_dot(simd, &mut sum, a, a_width, b.clone(), first);
                for (row, sum) in sum.iter().enumerate() {
                    let at = row * width + first;
                    c[at..at + V].copy_from_slice(&finish(
                        simd,
                        *sum,
                        self.epilogue,
                        tile * R * width + at,
                    ));
                }
            }
        }
    }
}

#[inline(always)]
fn start<S: Simd, const R: usize, const V: usize>(
    simd: S,
    c: &[S::f32s],
    width: usize,
    first: usize,
    prologue: Prologue,
) -> [[S::f32s; V]; R] {
    match prologue {
        Prologue::Zero => [[simd.splat_f32s(0.0); V]; R],
        Prologue::Add => {
            std::array::from_fn(|row| std::array::from_fn(|v| c[row * width + first + v]))
        }
    }
}

/// Adds the products of R rows of `a`, of `a_width` numbers, with V vectors of columns of `b`, from
/// vector `first` on.
#[inline(always)]
fn add_dot<'a, S: Simd, const R: usize, const V: usize>(
    simd: S,
    sum: &mut [[S::f32s; V]; R],
    a: &[f32],
    a_width: usize,
    b: impl Iterator<Item = &'a [S::f32s]>,
    first: usize,
) {
    assert!(a.len() == R * a_width, "product: a tile of a");
    // `b` ends with the inner extent: what rows of `a` have beyond it is not looked at.
    for (k, b) in (0..a_width).zip(b) {
        // sum[R][V] += a[R][k] b[k][V]: R broadcasts and V loads for R V fused multiply-adds.
        let b: [S::f32s; V] = std::array::from_fn(|v| b[first + v]);
        for (row, sum) in sum.iter_mut().enumerate() {
            let x = simd.splat_f32s(a[row * a_width + k]);
            for (sum, b) in sum.iter_mut().zip(b) {
                *sum = simd.mul_add_f32s(x, b, *sum);
            }
        }
    }
}

#[inline(always)]
fn finish<S: Simd, const V: usize>(
    simd: S,
    sum: [S::f32s; V],
    epilogue: Epilogue<'_>,
    at: usize,
) -> [S::f32s; V] {
    let zero = simd.splat_f32s(0.0);
    match epilogue {
        Epilogue::Keep => sum,
        Epilogue::Relu => sum.map(|x| simd.max_f32s(x, zero)),
        Epilogue::ReluBackward(output) => {
            let output = &S::as_simd_f32s(output).0[at..at + V];
            std::array::from_fn(|v| {
                // By the output and not the input: they are above 0 together, and only the output
                // was kept.
                simd.select_f32s(simd.less_than_f32s(zero, output[v]), sum[v], zero)
            })
        }
    }
}

/// c[k, m] += transpose(a[n, k]) b[n, m] for `shape` = [k, m]: the gradient of a weight from its
/// input `a` and the gradient `b` of its output. k is a multiple of 4, and of [`ROWS`] where m is
/// less than 2 [`COLUMNS`].
pub fn add_transposed_product(c: &mut [f32], a: Matrix<'_>, b: Matrix<'_>, shape: [usize; 2]) {
    let [inner, columns] = shape;
    assert!(
        columns.is_multiple_of(COLUMNS) && columns == b.width,
        "transposed product: {shape:?} of {}",
        b.width
    );
    assert!(
        inner <= a.width && c.len() == inner * columns,
        "transposed product: {shape:?} of {}",
        a.width
    );
    assert!(
        a.rows() == b.rows(),
        "transposed product: {} and {} rows",
        a.rows(),
        b.rows()
    );
    Arch::new().dispatch(TransposedProduct { c, a, b });
}

struct TransposedProduct<'a> {
    c: &'a mut [f32],
    a: Matrix<'a>,
    b: Matrix<'a>,
}

impl WithSimd for TransposedProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.b.width / S::F32_LANES {
            n if n.is_multiple_of(4) && S::REGISTER_COUNT >= 32 => self.tiles::<S, 4, 4>(simd),
            n if n.is_multiple_of(2) => self.tiles::<S, 4, 2>(simd),
            _ => self.tiles::<S, 8, 1>(simd),
        }
    }
}

impl TransposedProduct<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const R: usize, const V: usize>(self, simd: S) {
        let Self { c, a, b } = self;
        assert!(
            c.len().is_multiple_of(R * b.width),
            "transposed product: not whole tiles"
        );
        let width = b.width / S::F32_LANES;
        let blocks = a
            .values
            .chunks(ROW_BLOCK * a.width)
            .zip(b.values.chunks(ROW_BLOCK * b.width));
        // c[R][V] stays in registers over a block of rows. Blocks follow each other in order, so
        // that a sum has one order whatever the tile.
        for (rows, b_rows) in blocks {
            let b_rows = S::as_simd_f32s(b_rows).0;
            for (tile, c) in c.chunks_exact_mut(R * b.width).enumerate() {
                let c = S::as_mut_simd_f32s(c).0;
                for first in (0..width).step_by(V) {
                    let mut sum: [[S::f32s; V]; R] = start(simd, c, width, first, Prologue::Add);
                    add_outer(
                        simd,
                        &mut sum,
                        rows.chunks_exact(a.width),
                        tile * R,
                        b_rows.chunks_exact(width),
                        first,
                    );
                    for (row, sum) in sum.iter().enumerate() {
                        c[row * width + first..][..V].copy_from_slice(sum);
                    }
                }
            }
        }
    }
}

/// Adds, over the rows of `a` and `b`, the products of R columns of `a` with V vectors of `b`.
#[inline(always)]
fn add_outer<'a, S: Simd, const R: usize, const V: usize>(
    simd: S,
    sum: &mut [[S::f32s; V]; R],
    a: impl Iterator<Item = &'a [f32]>,
    first_a: usize,
    b: impl Iterator<Item = &'a [S::f32s]>,
    first_b: usize,
) {
    for (a, b) in a.zip(b) {
        let a = &a[first_a..first_a + R];
        let b: [S::f32s; V] = std::array::from_fn(|v| b[first_b + v]);
        for (sum, &a) in sum.iter_mut().zip(a) {
            let x = simd.splat_f32s(a);
            for (sum, b) in sum.iter_mut().zip(b) {
                *sum = simd.mul_add_f32s(x, b, *sum);
            }
        }
    }
}

#[cfg(test)]
mod tests;
