//! Nonlinearities, with the gradients of those that are trained through. All work element by
//! element; only the gated one knows an axis, the last, and [`prelu`] the channels of images.

use super::function::{Binary, Unary};
use super::{binary, cpu, gpu, unary};
use crate::runtime::array::{Array, nchw, vector};
use crate::runtime::device::Backend;

/// `x sigmoid(x)` (Elfwing et al. 2017).
pub fn silu(x: &Array) -> Array {
    unary(Unary::Silu, x)
}

/// The gradient of [`silu`] at `x`, times `dy`.
pub fn silu_backward(x: &Array, dy: &Array) -> Array {
    binary("silu_backward", Binary::SiluSlope, x, dy)
}

/// `x Phi(x)` with the exact distribution function `Phi`, not its tanh approximation (Hendrycks and
/// Gimpel 2016).
pub fn gelu(x: &Array) -> Array {
    unary(Unary::Gelu, x)
}

/// The gradient of [`gelu`] at `x`, times `dy`.
pub fn gelu_backward(x: &Array, dy: &Array) -> Array {
    binary("gelu_backward", Binary::GeluSlope, x, dy)
}

/// `x sigmoid(1.702 x)`, the approximation of [`gelu`] that CLIP was trained with.
pub fn quick_gelu(x: &Array) -> Array {
    unary(Unary::QuickGelu, x)
}

/// The gradient of [`quick_gelu`] at `x`, times `dy`.
pub fn quick_gelu_backward(x: &Array, dy: &Array) -> Array {
    binary("quick_gelu_backward", Binary::QuickGeluSlope, x, dy)
}

/// The rectifier `max(x, 0)`, element by element.
pub fn relu(x: &Array) -> Array {
    unary(Unary::Leaky(0.0), x)
}

/// `x` above 0, `slope x` below.
pub fn leaky_relu(x: &Array, slope: f32) -> Array {
    unary(Unary::Leaky(slope), x)
}

/// `1 / (1 + exp(-x))`.
pub fn sigmoid(x: &Array) -> Array {
    unary(Unary::Sigmoid, x)
}

/// [`leaky_relu`] of `x [N, C, H, W]` with a slope for each channel, `slopes [C]` (He et al. 2015).
pub fn prelu(x: &Array, slopes: &Array) -> Array {
    let [_, c, h, w] = nchw("prelu", x);
    vector("prelu", "the slopes", slopes, c);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            x.shape(),
            cpu::leaky_per_channel(x.host(), slopes.host(), h * w),
        ),
        Backend::Gpu(gpu) => {
            let slopes = (slopes.device_buffer(), c);
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::leaky_per_channel(gpu, x.device_buffer(), slopes, h * w, x.len()),
            )
        }
    }
}

fn gated_shape(op: &str, x: &Array) -> Vec<usize> {
    let mut shape = x.shape().to_vec();
    match shape.last_mut() {
        Some(last) if last.is_multiple_of(2) => *last /= 2,
        _ => panic!("{op}: the last axis of {:?} does not halve", x.shape()),
    }
    shape
}

/// `a gelu(b)` where `a` and `b` are the first and second half of the last axis of `x [.., 2C]`:
/// `[.., C]`. Shazeer 2020, equation 6, with the halves in diffusers' order.
pub fn geglu(x: &Array) -> Array {
    let shape = gated_shape("geglu", x);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&shape, cpu::geglu(x.host(), x.last() / 2)),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            &shape,
            gpu::geglu(gpu, x.device_buffer(), x.last() / 2, x.len() / 2),
        ),
    }
}

/// The gradient of [`geglu`] at `x [.., 2C]` for `dy [.., C]`: `[.., 2C]`.
pub fn geglu_backward(x: &Array, dy: &Array) -> Array {
    assert_eq!(
        dy.shape(),
        gated_shape("geglu_backward", x),
        "geglu_backward: input {:?}",
        x.shape()
    );
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            x.shape(),
            cpu::geglu_backward(x.host(), dy.host(), dy.last()),
        ),
        Backend::Gpu(gpu) => {
            let values = x.device_buffer();
            let dy_values = dy.device_buffer();
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::geglu_backward(gpu, values, dy_values, dy.last(), x.len()),
            )
        }
    }
}
