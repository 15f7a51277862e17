//! Two-dimensional convolution (cross-correlation, as networks mean it) and its gradients. It knows
//! images as `[N, C, H, W]` and weights as `[O, C, kh, kw]`.

mod cpu;
pub(crate) mod geometry;
pub(crate) mod gpu;
mod patches;
#[cfg(test)]
mod tests;
mod turned;
mod winograd;

use crate::runtime::array::{Array, nchw, vector};
use crate::runtime::device::Backend;
use crate::runtime::weight::{Weight, kernels};

use geometry::Geometry;

pub use super::product::finish::Finish;
pub use geometry::Conv;

/// Convolves `x [N, C, H, W]` with `weight [O, C, kh, kw]` and adds `bias [O]`: `[N, O, H', W']`.
pub fn conv2d(x: &Array, weight: impl Into<Weight>, bias: Option<&Array>, conv: Conv) -> Array {
    conv2d_finished(x, weight, bias, conv, Finish::None)
}

/// [`conv2d`] whose results are finished before they are stored; what is added has the result's
/// shape.
pub fn conv2d_finished(
    x: &Array,
    weight: impl Into<Weight>,
    bias: Option<&Array>,
    conv: Conv,
    finish: Finish<&Array>,
) -> Array {
    let weight = weight.into();
    let [n, c, height, width] = nchw("conv2d", x);
    let [o, wc, kh, kw] = kernels("conv2d", &weight);
    assert_eq!(
        c,
        wc,
        "conv2d: input {:?} and weight {:?}",
        x.shape(),
        weight.shape()
    );
    let g = Geometry::new("conv2d", [n, c, height, width], o, [kh, kw], conv);
    if let Some(bias) = bias {
        vector("conv2d", "bias", bias, o);
    }
    let shape = [n, o, g.out_height, g.out_width];
    if let Finish::Add(other) = finish {
        assert_eq!(
            other.shape(),
            shape,
            "conv2d: what is added has another shape"
        );
    }
    match x.device().backend() {
        Backend::Cpu => {
            let bias = bias.map(Array::host);
            let finish = finish.map(Array::host);
            let values = cpu::forward(x.host(), &weight, bias, finish, &g);
            Array::on_cpu(&shape, values)
        }
        Backend::Gpu(gpu) => {
            let bias = bias.map(Array::device_buffer);
            let finish = finish.map(Array::device_buffer);
            let weight = weight.factor(gpu);
            let values = gpu::forward(gpu, x.device_buffer(), weight, bias, finish, &g);
            Array::on_gpu(gpu, &shape, values)
        }
    }
}

/// The gradient of [`conv2d`] to its input, whose height and width are `size`: `[N, C, H, W]`.
pub fn conv2d_backward_input(
    dy: &Array,
    weight: impl Into<Weight>,
    conv: Conv,
    size: [usize; 2],
) -> Array {
    let op = "conv2d_backward_input";
    let weight = weight.into();
    let [n, _, _, _] = nchw(op, dy);
    let [o, c, kh, kw] = kernels(op, &weight);
    // With a stride, inputs of several sizes have outputs of one size, so `dy` does not tell it.
    let geometry = Geometry::new(op, [n, c, size[0], size[1]], o, [kh, kw], conv);
    geometry.expect_output(op, dy.shape());
    match dy.device().backend() {
        Backend::Cpu => {
            let values =
                cpu::backward_input(dy.host(), (weight.host(), weight.precision()), &geometry);
            Array::on_cpu(&[n, c, size[0], size[1]], values)
        }
        Backend::Gpu(gpu) => {
            let values =
                gpu::backward_input(gpu, dy.device_buffer(), weight.factor(gpu), &geometry);
            Array::on_gpu(gpu, &[n, c, size[0], size[1]], values)
        }
    }
}

/// The gradient of [`conv2d`] to its weight, with `kernel` = `[kh, kw]`: `[O, C, kh, kw]`.
pub fn conv2d_backward_weight(x: &Array, dy: &Array, conv: Conv, kernel: [usize; 2]) -> Array {
    let op = "conv2d_backward_weight";
    let [_, c, _, _] = nchw(op, x);
    let [_, o, _, _] = nchw(op, dy);
    let geometry = Geometry::new(op, nchw(op, x), o, kernel, conv);
    geometry.expect_output(op, dy.shape());
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[o, c, kernel[0], kernel[1]],
            cpu::backward_weight(x.host(), dy.host(), &geometry),
        ),
        Backend::Gpu(gpu) => {
            let values =
                gpu::backward_weight(gpu, x.device_buffer(), dy.device_buffer(), &geometry);
            Array::on_gpu(gpu, &[o, c, kernel[0], kernel[1]], values)
        }
    }
}
