//! Matrix products over tokens.

use super::factor::{Stored, Turned};
use super::product::{Start, product};
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::values::Values;
use crate::runtime::format::Precision;

/// `a [m, k]` times `b [k, n]`.
pub fn matmul(a: &[f32], b: &[f32], [m, k, n]: [usize; 3]) -> HostBuffer {
    product(
        [1, m, n],
        k,
        &Matrix::new(a, m, k),
        &Matrix::new(b, k, n),
        Start::Zero,
        Precision::F32,
    )
}

/// `x [rows, k]` times the transpose of `weight [m, k]`, plus `bias [m]`.
pub fn linear(
    x: &[f32],
    (weight, precision): (Values, Precision),
    bias: Option<&[f32]>,
    [rows, k, m]: [usize; 3],
) -> HostBuffer {
    let weight = Turned(Stored {
        values: weight,
        columns: k,
    });
    product(
        [1, rows, m],
        k,
        &Matrix::new(x, rows, k),
        &weight,
        bias.map_or(Start::Zero, Start::Columns),
        precision,
    )
}

/// `dy [rows, m]` times `weight [m, k]`.
pub fn backward_input(
    dy: &[f32],
    (weight, precision): (Values, Precision),
    [rows, k, m]: [usize; 3],
) -> HostBuffer {
    product(
        [1, rows, k],
        m,
        &Matrix::new(dy, rows, m),
        &Stored {
            values: weight,
            columns: k,
        },
        Start::Zero,
        precision,
    )
}

/// The transpose of `dy [rows, m]` times `x [rows, k]`.
pub fn backward_weight(x: &[f32], dy: &[f32], [rows, k, m]: [usize; 3]) -> HostBuffer {
    product(
        [1, m, k],
        rows,
        &Matrix::new(dy, rows, m).transposed(),
        &Matrix::new(x, rows, k),
        Start::Zero,
        Precision::F32,
    )
}
