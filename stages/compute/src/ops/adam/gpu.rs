//! One step of Adam on a GPU.

use super::step::Step;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::job::Job;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::folded;
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

params! {
    /// A [`Step`] over `len` numbers.
    struct StepOver {
        len: u32,
        beta1: f32,
        beta2: f32,
        eps: f32,
        rate: f32,
        root: f32,
        keep: f32,
    }
}

impl StepOver {
    fn new(step: Step, len: usize) -> StepOver {
        StepOver {
            len: len as u32,
            beta1: step.beta1,
            beta2: step.beta2,
            eps: step.eps,
            rate: step.rate,
            root: step.root,
            keep: step.keep,
        }
    }
}

/// One step of Adam on `[parameter, gradient, mean, square]`: the new parameter and moments.
pub fn advance(gpu: &Gpu, step: Step, arrays: [&Buffer; 4], len: usize) -> [Buffer; 3] {
    let kernel = Kernel::new("adam", &[include_str!("adam.wgsl")], [4, 3]);
    // Results go to new buffers: other arrays may still share the old ones.
    let out = [0; 3].map(|_| gpu.buffer(len));
    let [parameter, gradient, mean, square] = arrays;
    gpu.run(&Job {
        kernel: &kernel,
        arrays: &[parameter, gradient, mean, square, &out[0], &out[1], &out[2]],
        params: StepOver::new(step, len),
        groups: folded(len.div_ceil(256)),
        operations: 12 * len as u64,
    });
    out
}
