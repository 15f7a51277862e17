//! The Adam optimiser. It knows one parameter array at a time and keeps its moments in a state
//! beside it.

mod cpu;
mod gpu;
mod step;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, same_shape};
use crate::runtime::device::Backend;

use step::Step;

/// The constants of one optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adam {
    /// Step size: about how far one step moves a value whose gradient keeps its sign.
    pub rate: f32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Keeps the division finite.
    pub eps: f32,
    /// Decoupled weight decay per unit of `rate` (Loshchilov and Hutter 2017); 0 for plain Adam.
    pub weight_decay: f32,
}

impl Default for Adam {
    /// The paper's constants, without weight decay.
    fn default() -> Adam {
        Adam {
            rate: 1e-3,
            beta1: 0.9,
            beta2: 0.999,
            eps: 1e-8,
            weight_decay: 0.0,
        }
    }
}

/// The moments of one parameter's gradient.
#[derive(Clone, Debug)]
pub struct AdamState {
    /// Decayed mean of the gradient.
    pub m: Array,
    /// Decayed mean of the gradient's square.
    pub v: Array,
}

impl AdamState {
    /// The state before the first step.
    pub fn new(parameter: &Array) -> AdamState {
        let zeros = parameter.device().zeros(parameter.shape());
        AdamState {
            m: zeros.clone(),
            v: zeros,
        }
    }
}

/// One step of Adam on `parameter`, in place; `step` counts from 1. Kingma and Ba 2014, algorithm
/// 1.
pub fn update(
    adam: &Adam,
    parameter: &mut Array,
    gradient: &Array,
    state: &mut AdamState,
    step: u64,
) {
    same_shape("adam", parameter, gradient);
    same_shape("adam", parameter, &state.m);
    same_shape("adam", parameter, &state.v);
    assert!(step > 0, "adam: steps count from 1");
    // In f64: for beta2 = 0.999 the first of these is 1e-3, with few digits left in f32.
    let bias = |beta: f32| 1.0 - f64::from(beta).powf(step as f64);
    let factors = Step {
        beta1: adam.beta1,
        beta2: adam.beta2,
        eps: adam.eps,
        rate: (f64::from(adam.rate) / bias(adam.beta1)) as f32,
        root: (1.0 / bias(adam.beta2).sqrt()) as f32,
        keep: 1.0 - adam.rate * adam.weight_decay,
    };
    let backend = parameter.device().backend().clone();
    match backend {
        Backend::Cpu => cpu::advance(
            factors,
            parameter.host_mut(),
            gradient.host(),
            state.m.host_mut(),
            state.v.host_mut(),
        ),
        Backend::Gpu(gpu) => {
            let old = [&*parameter, gradient, &state.m, &state.v].map(Array::device_buffer);
            let new = gpu::advance(&gpu, factors, old, gradient.len());
            [*parameter, state.m, state.v] =
                new.map(|values| Array::on_gpu(&gpu, gradient.shape(), values));
        }
    }
}
