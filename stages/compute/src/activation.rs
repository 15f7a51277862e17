//! Nonlinearities, each with its gradient. All work element by element; only the gated one knows an axis, the last.

use crate::array::{Array, same_shape};
use crate::cpu;
use crate::device::Backend;

/// The functions of one real variable that kernels exist for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Function {
    Silu,
    Gelu,
    QuickGelu,
}

fn apply(function: Function, x: &Array) -> Array {
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::activation::apply(function, x.host())),
    }
}

fn apply_backward(function: Function, op: &str, x: &Array, dy: &Array) -> Array {
    same_shape(op, x, dy);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::activation::backward(function, x.host(), dy.host())),
    }
}

/// `x sigmoid(x)` (Elfwing et al. 2017).
pub fn silu(x: &Array) -> Array {
    apply(Function::Silu, x)
}

/// The gradient of [`silu`] at `x`, times `dy`.
pub fn silu_backward(x: &Array, dy: &Array) -> Array {
    apply_backward(Function::Silu, "silu_backward", x, dy)
}

/// `x Phi(x)` with the exact distribution function `Phi`, not its tanh approximation (Hendrycks and Gimpel 2016).
pub fn gelu(x: &Array) -> Array {
    apply(Function::Gelu, x)
}

/// The gradient of [`gelu`] at `x`, times `dy`.
pub fn gelu_backward(x: &Array, dy: &Array) -> Array {
    apply_backward(Function::Gelu, "gelu_backward", x, dy)
}

/// `x sigmoid(1.702 x)`, the approximation of [`gelu`] that CLIP was trained with.
pub fn quick_gelu(x: &Array) -> Array {
    apply(Function::QuickGelu, x)
}

/// The gradient of [`quick_gelu`] at `x`, times `dy`.
pub fn quick_gelu_backward(x: &Array, dy: &Array) -> Array {
    apply_backward(Function::QuickGelu, "quick_gelu_backward", x, dy)
}

fn gated_shape(op: &str, x: &Array) -> Vec<usize> {
    let mut shape = x.shape().to_vec();
    match shape.last_mut() {
        Some(last) if last.is_multiple_of(2) => *last /= 2,
        _ => panic!("{op}: the last axis of {:?} does not halve", x.shape()),
    }
    shape
}

/// `a gelu(b)` where `a` and `b` are the first and second half of the last axis of `x [.., 2C]`: `[.., C]`.
/// Shazeer 2020, equation 6, with the halves in diffusers' order.
pub fn geglu(x: &Array) -> Array {
    let shape = gated_shape("geglu", x);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&shape, cpu::activation::geglu(x.host(), x.last() / 2)),
    }
}

/// The gradient of [`geglu`] at `x [.., 2C]` for `dy [.., C]`: `[.., 2C]`.
pub fn geglu_backward(x: &Array, dy: &Array) -> Array {
    assert_eq!(dy.shape(), gated_shape("geglu_backward", x), "geglu_backward: input {:?}", x.shape());
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::activation::geglu_backward(x.host(), dy.host(), dy.last())),
    }
}
