//! Arithmetic on arrays of equal shape. It knows no axes, but for the per-channel bias of images.

pub mod activation;
mod cpu;
mod function;
mod gpu;
pub mod reduce;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, matrix, nchw, same_shape};
use crate::runtime::device::Backend;

use function::{Binary, Unary};

/// `function` of every element.
pub(crate) fn unary(function: Unary, x: &Array) -> Array {
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::unary(function, x.host())),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            x.shape(),
            gpu::unary(gpu, function, x.device_buffer(), x.len()),
        ),
    }
}

/// `function` of every pair of elements; `op` names the caller in messages.
pub(crate) fn binary(op: &str, function: Binary, x: &Array, y: &Array) -> Array {
    same_shape(op, x, y);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::binary(function, x.host(), y.host())),
        Backend::Gpu(gpu) => {
            let values = gpu::binary(gpu, function, x.device_buffer(), y.device_buffer(), x.len());
            Array::on_gpu(gpu, x.shape(), values)
        }
    }
}

/// `x + y`, element by element; the shapes are equal.
pub fn add(x: &Array, y: &Array) -> Array {
    scaled_sum(&[(1.0, x), (1.0, y)])
}

/// `x - y`, element by element; the shapes are equal.
pub fn sub(x: &Array, y: &Array) -> Array {
    scaled_sum(&[(1.0, x), (-1.0, y)])
}

/// The product, element by element.
pub fn mul(x: &Array, y: &Array) -> Array {
    binary("mul", Binary::Product, x, y)
}

/// Every element times `factor`.
pub fn scale(x: &Array, factor: f32) -> Array {
    unary(Unary::Scale(factor), x)
}

/// `number` added to every element.
pub fn offset(x: &Array, number: f32) -> Array {
    unary(Unary::Offset(number), x)
}

/// `a x + b y + ..` for terms `(a, x), (b, y), ..`, summed from left to right.
pub fn scaled_sum(terms: &[(f32, &Array)]) -> Array {
    match *terms {
        [] => panic!("scaled_sum: no terms"),
        [(a, x)] => scale(x, a),
        [(a, x), (b, y)] => binary("scaled_sum", Binary::Sum([a, b]), x, y),
        // From the left: the order of the sum is part of the result.
        [ref first @ .., (a, x)] => {
            binary("scaled_sum", Binary::Sum([1.0, a]), &scaled_sum(first), x)
        }
    }
}

/// `x [N, C, H, W]` with `bias [N, C]` added to every pixel.
pub fn add_channels(x: &Array, bias: &Array) -> Array {
    let [n, c, h, w] = nchw("add_channels", x);
    let per_image = matrix("add_channels", bias);
    assert_eq!(
        [n, c],
        per_image,
        "add_channels: input {:?}, bias {:?}",
        x.shape(),
        bias.shape()
    );
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::add_per_plane(x.host(), bias.host(), h * w)),
        Backend::Gpu(gpu) => {
            let values =
                gpu::add_per_plane(gpu, x.device_buffer(), bias.device_buffer(), h * w, x.len());
            Array::on_gpu(gpu, x.shape(), values)
        }
    }
}

/// Every element moved into `low..=high`; NaN stays NaN.
pub fn clamp(x: &Array, low: f32, high: f32) -> Array {
    assert!(low <= high, "clamp: nothing lies in {low}..={high}");
    unary(Unary::Clamp { low, high }, x)
}

/// -1, 0 or 1 by the sign of every element.
pub fn sign(x: &Array) -> Array {
    unary(Unary::Sign, x)
}
