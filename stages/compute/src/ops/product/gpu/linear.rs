//! Matrix products over tokens.

use super::product::{Along, Product};
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::factor::Factor;
use crate::runtime::gpu::pool::Buffer;

/// `a [m, k]` times `b [k, n]`.
pub fn matmul(gpu: &Gpu, a: &Buffer, b: &Buffer, [m, k, n]: [usize; 3]) -> Buffer {
    Product::dense(a.into(), b.into(), [m, k, n], [k, 1, n, 1]).run(gpu)
}

/// `x [rows, k]` times the transpose of `weight [m, k]`, plus `bias [m]`.
pub fn linear(
    gpu: &Gpu,
    x: &Buffer,
    weight: Factor,
    bias: Option<&Buffer>,
    [rows, k, m]: [usize; 3],
) -> Buffer {
    let bias = bias.map(|bias| (bias, Along::Columns));
    Product {
        bias,
        ..Product::dense(x.into(), weight, [rows, k, m], [k, 1, 1, k])
    }
    .run(gpu)
}

/// `dy [rows, m]` times `weight [m, k]`.
pub fn backward_input(gpu: &Gpu, dy: &Buffer, weight: Factor, [rows, k, m]: [usize; 3]) -> Buffer {
    Product::dense(dy.into(), weight, [rows, m, k], [m, 1, k, 1]).run(gpu)
}

/// The transpose of `dy [rows, m]` times `x [rows, k]`.
pub fn backward_weight(gpu: &Gpu, x: &Buffer, dy: &Buffer, [rows, k, m]: [usize; 3]) -> Buffer {
    Product::dense(dy.into(), x.into(), [m, rows, k], [1, m, k, 1]).run(gpu)
}
