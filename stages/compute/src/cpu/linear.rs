//! Matrix products over tokens.

use super::gemm::{Matrix, MatrixMut, Threads, multiply};

/// `a [m, k]` times `b [k, n]`.
pub fn matmul(a: &[f32], b: &[f32], [m, k, n]: [usize; 3]) -> Vec<f32> {
    product(Matrix::new(a, m, k), Matrix::new(b, k, n), m, n)
}

/// `x [rows, k]` times the transpose of `weight [m, k]`, plus `bias [m]`.
pub fn linear(x: &[f32], weight: &[f32], bias: Option<&[f32]>, [rows, k, m]: [usize; 3]) -> Vec<f32> {
    let (a, b) = (Matrix::new(x, rows, k), Matrix::new(weight, m, k).transposed());
    let Some(bias) = bias else { return product(a, b, rows, m) };
    let mut out = bias.repeat(rows);
    multiply(&mut MatrixMut::new(&mut out, rows, m), a, b, true, Threads::All);
    out
}

/// The transpose of `dy [rows, m]` times `x [rows, k]`.
pub fn backward_weight(x: &[f32], dy: &[f32], [rows, k, m]: [usize; 3]) -> Vec<f32> {
    product(Matrix::new(dy, rows, m).transposed(), Matrix::new(x, rows, k), m, k)
}

fn product(a: Matrix, b: Matrix, m: usize, n: usize) -> Vec<f32> {
    let mut out = vec![0.0; m * n];
    multiply(&mut MatrixMut::new(&mut out, m, n), a, b, false, Threads::All);
    out
}
