//! Products of tall matrices (one row per sample) with small ones. Knows nothing of what the rows mean.
//!
//! Everything is row-major. Rows come in multiples of [`ROWS`], columns in multiples of [`COLUMNS`]; callers pad.
//! Vectors run along columns, so each output element is one chain of fused multiply-adds in order of the inner index.

use pulp::{Arch, Simd, WithSimd};

/// Rows of a register tile: row counts are multiples of it.
pub const ROWS: usize = 8;
/// Floats of the widest vector: column counts are multiples of it.
pub const COLUMNS: usize = 16;
/// Rows whose activations stay in the first-level cache while a weight gradient is summed.
const ROW_BLOCK: usize = 64;

/// What happens to a product on its way to memory.
#[derive(Clone, Copy)]
pub enum Epilogue<'a> {
    /// Nothing.
    Keep,
    /// max(x, 0).
    Relu,
    /// The backward pass of `Relu`: zero where this output of it was zero.
    ReluBackward(&'a [f32]),
}

/// c[n, m] = epilogue(a[n, k] b[k, m]).
pub fn product(c: &mut [f32], a: &[f32], b: &[f32], inner: usize, columns: usize, epilogue: Epilogue<'_>) {
    assert!(columns.is_multiple_of(COLUMNS) && b.len() == inner * columns, "product: b is not {inner} x {columns}");
    assert!(c.len().is_multiple_of(ROWS * columns) && a.len() * columns == c.len() * inner, "product: rows differ");
    Arch::new().dispatch(Product { c, a, b, inner, columns, epilogue });
}

struct Product<'a> {
    c: &'a mut [f32],
    a: &'a [f32],
    b: &'a [f32],
    inner: usize,
    columns: usize,
    epilogue: Epilogue<'a>,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.columns / S::F32_LANES {
            n if n.is_multiple_of(4) && S::REGISTER_COUNT >= 32 => self.tiles::<S, 4, 4>(simd),
            n if n.is_multiple_of(2) => self.tiles::<S, 4, 2>(simd),
            _ => self.tiles::<S, 8, 1>(simd),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const R: usize, const V: usize>(self, simd: S) {
        let width = self.columns / S::F32_LANES;
        let b = S::as_simd_f32s(self.b).0;
        let rows = self.c.chunks_exact_mut(R * self.columns).zip(self.a.chunks_exact(R * self.inner));
        for (tile, (c, a)) in rows.enumerate() {
            let c = S::as_mut_simd_f32s(c).0;
            for first in (0..width).step_by(V) {
                let sum = dot::<S, R, V>(simd, a, b, self.inner, width, first);
                for (row, sum) in sum.iter().enumerate() {
                    let at = row * width + first;
                    c[at..at + V].copy_from_slice(&finish(simd, *sum, self.epilogue, tile * R * width + at));
                }
            }
        }
    }
}

/// R rows of `a` times V vectors of columns of `b`, from vector `first` of `width`.
#[inline(always)]
fn dot<S: Simd, const R: usize, const V: usize>(
    simd: S,
    a: &[f32],
    b: &[S::f32s],
    inner: usize,
    width: usize,
    first: usize,
) -> [[S::f32s; V]; R] {
    let rows: [&[f32]; R] = std::array::from_fn(|row| &a[row * inner..(row + 1) * inner]);
    let mut sum = [[simd.splat_f32s(0.0); V]; R];
    for (k, b) in b.chunks_exact(width).take(inner).enumerate() {
        let b: [S::f32s; V] = std::array::from_fn(|v| b[first + v]);
        for (sum, row) in sum.iter_mut().zip(rows) {
            let x = simd.splat_f32s(row[k]);
            for (sum, b) in sum.iter_mut().zip(b) {
                *sum = simd.mul_add_f32s(x, b, *sum);
            }
        }
    }
    sum
}

#[inline(always)]
fn finish<S: Simd, const V: usize>(simd: S, sum: [S::f32s; V], epilogue: Epilogue<'_>, at: usize) -> [S::f32s; V] {
    let zero = simd.splat_f32s(0.0);
    match epilogue {
        Epilogue::Keep => sum,
        Epilogue::Relu => sum.map(|x| simd.max_f32s(x, zero)),
        Epilogue::ReluBackward(output) => {
            let output = &S::as_simd_f32s(output).0[at..at + V];
            std::array::from_fn(|v| simd.select_f32s(simd.less_than_f32s(zero, output[v]), sum[v], zero))
        }
    }
}

/// c[k, m] += transpose(a[n, k]) b[n, m]: the gradient of a weight from its input `a` and the gradient `b` of its
/// output.
pub fn add_transposed_product(c: &mut [f32], a: &[f32], b: &[f32], inner: usize, columns: usize) {
    assert!(columns.is_multiple_of(COLUMNS) && inner.is_multiple_of(ROWS), "transposed product: {inner} x {columns}");
    assert!(c.len() == inner * columns && a.len() * columns == b.len() * inner, "transposed product: rows differ");
    Arch::new().dispatch(TransposedProduct { c, a, b, inner, columns });
}

struct TransposedProduct<'a> {
    c: &'a mut [f32],
    a: &'a [f32],
    b: &'a [f32],
    inner: usize,
    columns: usize,
}

impl WithSimd for TransposedProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.columns / S::F32_LANES {
            n if n.is_multiple_of(4) && S::REGISTER_COUNT >= 32 => self.tiles::<S, 4, 4>(simd),
            n if n.is_multiple_of(2) => self.tiles::<S, 4, 2>(simd),
            _ => self.tiles::<S, 8, 1>(simd),
        }
    }
}

impl TransposedProduct<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const R: usize, const V: usize>(self, simd: S) {
        let width = self.columns / S::F32_LANES;
        let blocks = self.a.chunks(ROW_BLOCK * self.inner).zip(self.b.chunks(ROW_BLOCK * self.columns));
        for (a, b) in blocks {
            let b = S::as_simd_f32s(b).0;
            for (tile, c) in self.c.chunks_exact_mut(R * self.columns).enumerate() {
                let c = S::as_mut_simd_f32s(c).0;
                for first in (0..width).step_by(V) {
                    let mut sum: [[S::f32s; V]; R] =
                        std::array::from_fn(|row| std::array::from_fn(|v| c[row * width + first + v]));
                    add_outer(simd, &mut sum, a.chunks_exact(self.inner), tile * R, b.chunks_exact(width), first);
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
mod tests {
    use super::*;
    use compute::rng::Rng;

    fn random(len: usize, domain: &str) -> Vec<f32> {
        let rng = Rng::new(1, domain);
        (0..len as u64).map(|i| rng.uniform(0, i) - 0.5).collect()
    }

    #[test]
    fn a_product_is_the_sum_over_the_inner_index() {
        for (rows, inner, columns) in [(8, 5, 16), (24, 64, 32), (16, 32, 64)] {
            let (a, b) = (random(rows * inner, "a"), random(inner * columns, "b"));
            let mut c = vec![0.0; rows * columns];
            product(&mut c, &a, &b, inner, columns, Epilogue::Keep);
            for (i, &got) in c.iter().enumerate() {
                let (row, column) = (i / columns, i % columns);
                let fused = (0..inner).fold(0f32, |sum, k| a[row * inner + k].mul_add(b[k * columns + column], sum));
                assert_eq!(got, fused, "the order of the sum does not depend on the machine");
            }
        }
    }

    #[test]
    fn relu_and_its_backward_pass_cut_the_same_elements() {
        let (a, b) = (random(8 * 4, "a"), random(4 * 16, "b"));
        let (mut plain, mut relu, mut backward) = (vec![0.0; 128], vec![0.0; 128], vec![0.0; 128]);
        product(&mut plain, &a, &b, 4, 16, Epilogue::Keep);
        product(&mut relu, &a, &b, 4, 16, Epilogue::Relu);
        product(&mut backward, &a, &b, 4, 16, Epilogue::ReluBackward(&relu));
        for i in 0..128 {
            assert_eq!(relu[i], plain[i].max(0.0));
            assert_eq!(backward[i], if plain[i] > 0.0 { plain[i] } else { 0.0 });
        }
    }

    #[test]
    fn a_transposed_product_adds_the_sum_over_rows() {
        let (rows, inner, columns) = (136, 32, 64);
        let (a, b) = (random(rows * inner, "a"), random(rows * columns, "b"));
        let mut c = vec![1.0; inner * columns];
        add_transposed_product(&mut c, &a, &b, inner, columns);
        for (i, &got) in c.iter().enumerate() {
            let (k, column) = (i / columns, i % columns);
            let want = (0..rows).fold(1f32, |sum, row| a[row * inner + k].mul_add(b[row * columns + column], sum));
            assert_eq!(got, want);
        }
    }

    #[cfg(target_arch = "x86_64")]
    /// Both kernels with the vectors of one instruction set.
    fn both<S: Simd>(simd: S) -> [Vec<f32>; 2] {
        let (rows, inner, columns) = (72, 32, 64);
        let (a, b, g) = (random(rows * inner, "a"), random(inner * columns, "b"), random(rows * columns, "g"));
        let (mut c, mut d) = (vec![0.0; rows * columns], vec![0.0; inner * columns]);
        simd.vectorize(Product { c: &mut c, a: &a, b: &b, inner, columns, epilogue: Epilogue::Relu });
        simd.vectorize(TransposedProduct { c: &mut d, a: &a, b: &g, inner, columns });
        [c, d]
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn every_vector_width_gives_the_same_bits() {
        let portable = both(pulp::Scalar);
        let avx2 = pulp::x86::V3::try_new().map(both);
        let avx512 = pulp::x86::V4::try_new().map(both);
        assert!(avx2.is_none_or(|results| results == portable));
        assert!(avx512.is_none_or(|results| results == portable));
    }
}
