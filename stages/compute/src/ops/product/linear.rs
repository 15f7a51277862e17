//! The fully connected layer `y = x W^T + b` and its gradients. It knows PyTorch's weight
//! layout, not what the layer is for.

use super::{cpu, gpu};
use crate::runtime::array::{Array, vector};
use crate::runtime::device::Backend;
use crate::runtime::weight::{Weight, matrix};

fn with_last(x: &Array, last: usize) -> Vec<usize> {
    let mut shape = x.shape().to_vec();
    if let Some(extent) = shape.last_mut() {
        *extent = last;
    }
    shape
}

fn rows(x: &Array) -> usize {
    x.len() / x.last().max(1)
}

/// `x [.., K]` times the transpose of `weight [M, K]`, plus `bias [M]`: `[.., M]`.
pub fn linear(x: &Array, weight: impl Into<Weight>, bias: Option<&Array>) -> Array {
    let weight = weight.into();
    let [m, k] = matrix("linear", &weight);
    assert_eq!(
        x.last(),
        k,
        "linear: input {:?} and weight {:?}",
        x.shape(),
        weight.shape()
    );
    if let Some(bias) = bias {
        vector("linear", "bias", bias, m);
    }
    match x.device().backend() {
        Backend::Cpu => {
            let values = cpu::linear::linear(
                x.host(),
                (weight.host(), weight.precision()),
                bias.map(Array::host),
                [rows(x), k, m],
            );
            Array::on_cpu(&with_last(x, m), values)
        }
        Backend::Gpu(gpu) => {
            let bias = bias.map(Array::device_buffer);
            let values = gpu::linear::linear(
                gpu,
                x.device_buffer(),
                weight.factor(gpu),
                bias,
                [rows(x), k, m],
            );
            Array::on_gpu(gpu, &with_last(x, m), values)
        }
    }
}

/// The gradient of [`linear`] to its input: `dy [.., M]` times `weight [M, K]`, `[.., K]`.
pub fn linear_backward_input(dy: &Array, weight: impl Into<Weight>) -> Array {
    let weight = weight.into();
    let [m, k] = matrix("linear_backward_input", &weight);
    assert_eq!(
        dy.last(),
        m,
        "linear_backward_input: gradient {:?} and weight {:?}",
        dy.shape(),
        weight.shape()
    );
    match dy.device().backend() {
        Backend::Cpu => {
            let values = cpu::linear::backward_input(
                dy.host(),
                (weight.host(), weight.precision()),
                [rows(dy), k, m],
            );
            Array::on_cpu(&with_last(dy, k), values)
        }
        Backend::Gpu(gpu) => {
            let values = gpu::linear::backward_input(
                gpu,
                dy.device_buffer(),
                weight.factor(gpu),
                [rows(dy), k, m],
            );
            Array::on_gpu(gpu, &with_last(dy, k), values)
        }
    }
}

/// The gradient of [`linear`] to its weight: the transpose of `dy [.., M]` times `x [.., K]`, `[M,
/// K]`.
pub fn linear_backward_weight(x: &Array, dy: &Array) -> Array {
    assert_eq!(
        rows(x),
        rows(dy),
        "linear_backward_weight: input {:?}, gradient {:?}",
        x.shape(),
        dy.shape()
    );
    let m = dy.last();
    let k = x.last();
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[m, k],
            cpu::linear::backward_weight(x.host(), dy.host(), [rows(x), k, m]),
        ),
        Backend::Gpu(gpu) => {
            let values = gpu::linear::backward_weight(
                gpu,
                x.device_buffer(),
                dy.device_buffer(),
                [rows(x), k, m],
            );
            Array::on_gpu(gpu, &[m, k], values)
        }
    }
}
