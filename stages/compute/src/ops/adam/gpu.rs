//! One step of Adam on a GPU.

use super::step::Step;
use crate::runtime::gpu::context::{Gpu, Job};
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::{bits, folded};
use crate::runtime::gpu::pool::Buffer;

/// One step of Adam on `[parameter, gradient, mean, square]`: the new parameter and moments.
pub fn advance(gpu: &Gpu, step: Step, arrays: [&Buffer; 4], len: usize) -> [Buffer; 3] {
    let kernel = Kernel::new("adam", &[include_str!("adam.wgsl")], [4, 3]);
    let out = [0; 3].map(|_| gpu.buffer(len));
    let [parameter, gradient, mean, square] = arrays;
    let factors = [
        step.beta1, step.beta2, step.eps, step.rate, step.root, step.keep,
    ]
    .map(bits);
    let words: Vec<u32> = std::iter::once(len as u32).chain(factors).collect();
    gpu.run(&Job {
        kernel: &kernel,
        arrays: &[parameter, gradient, mean, square, &out[0], &out[1], &out[2]],
        words: &words,
        groups: folded(len.div_ceil(256)),
        operations: 12 * len as u64,
    });
    out
}
