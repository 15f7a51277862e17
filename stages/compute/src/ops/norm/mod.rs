//! Group and layer normalisation with their gradients to the input. The scale and shift (`gamma`,
//! `beta`) are frozen weights here: nothing in this crate differentiates to them.

mod cpu;
mod gpu;
mod groups;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, same_shape, vector};
use crate::runtime::device::Backend;

use groups::Groups;

pub use groups::Activation;

fn groups_of(op: &str, x: &Array, gamma: &Array, groups: usize, eps: f32) -> Groups {
    let [_, channels, plane @ ..] = x.shape() else {
        panic!("{op}: expected [N, C, ..], got {:?}", x.shape())
    };
    assert!(
        groups > 0 && channels % groups == 0,
        "{op}: {channels} channels do not divide into {groups} groups"
    );
    vector(op, "gamma", gamma, *channels);
    Groups {
        channels: *channels,
        groups,
        plane: plane.iter().product(),
        eps,
    }
}

/// Normalises each of `groups` groups of channels of `x [N, C, ..]` to mean 0 and variance 1,
/// scales and shifts by `gamma [C]`, `beta [C]`, and applies `activation`. Wu and He 2018,
/// equations 1 to 7.
pub fn group_norm(
    x: &Array,
    gamma: &Array,
    beta: &Array,
    groups: usize,
    eps: f32,
    activation: Activation,
) -> Array {
    let extents = groups_of("group_norm", x, gamma, groups, eps);
    vector("group_norm", "beta", beta, extents.channels);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            x.shape(),
            cpu::group(x.host(), gamma.host(), beta.host(), extents, activation),
        ),
        Backend::Gpu(gpu) => {
            let values = x.device_buffer();
            let weights = [gamma, beta].map(Array::device_buffer);
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::group(gpu, values, weights, x.len(), extents, activation),
            )
        }
    }
}

/// The gradient of [`group_norm`] to its input `x`, given the gradient `dy` to its output.
pub fn group_norm_backward(
    x: &Array,
    gamma: &Array,
    beta: &Array,
    groups: usize,
    eps: f32,
    activation: Activation,
    dy: &Array,
) -> Array {
    let extents = groups_of("group_norm_backward", x, gamma, groups, eps);
    vector("group_norm_backward", "beta", beta, extents.channels);
    same_shape("group_norm_backward", x, dy);
    match x.device().backend() {
        Backend::Cpu => {
            let gamma = gamma.host();
            let beta = beta.host();
            Array::on_cpu(
                x.shape(),
                cpu::group_backward(x.host(), gamma, beta, extents, activation, dy.host()),
            )
        }
        Backend::Gpu(gpu) => {
            let [inputs, weights] =
                [[x, dy], [gamma, beta]].map(|pair| pair.map(Array::device_buffer));
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::group_backward(gpu, inputs, weights, x.len(), extents, activation),
            )
        }
    }
}

/// Normalises the last axis of `x [.., C]` to mean 0 and variance 1, then scales and shifts by
/// `gamma [C]`, `beta [C]`. Ba et al. 2016, equation 4.
pub fn layer_norm(x: &Array, gamma: &Array, beta: &Array, eps: f32) -> Array {
    vector("layer_norm", "gamma", gamma, x.last());
    vector("layer_norm", "beta", beta, x.last());
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            x.shape(),
            cpu::layer(x.host(), gamma.host(), beta.host(), eps),
        ),
        Backend::Gpu(gpu) => {
            let values = x.device_buffer();
            let weights = [gamma, beta].map(Array::device_buffer);
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::layer(gpu, values, weights, x.len(), x.last(), eps),
            )
        }
    }
}

/// The gradient of [`layer_norm`] to its input `x`, given the gradient `dy` to its output.
pub fn layer_norm_backward(x: &Array, gamma: &Array, eps: f32, dy: &Array) -> Array {
    vector("layer_norm_backward", "gamma", gamma, x.last());
    same_shape("layer_norm_backward", x, dy);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            x.shape(),
            cpu::layer_backward(x.host(), gamma.host(), eps, dy.host()),
        ),
        Backend::Gpu(gpu) => {
            let inputs = [x, dy].map(Array::device_buffer);
            let gamma = gamma.device_buffer();
            Array::on_gpu(
                gpu,
                x.shape(),
                gpu::layer_backward(gpu, inputs, gamma, x.len(), x.last(), eps),
            )
        }
    }
}
