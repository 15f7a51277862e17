//! How operators start kernels: what most of them have in common. It knows no operator.

use super::context::{Gpu, Job};
use super::kernel::Kernel;
use super::pool::Buffer;

/// Workgroups for `count` pieces of work, folded into two axes where one has not room enough.
pub fn folded(count: usize) -> [u32; 3] {
    let rows = count.div_ceil(1 << 15);
    [
        if rows > 1 { 1 << 15 } else { count as u32 },
        rows as u32,
        1,
    ]
}

/// The bits of a float as a parameter.
pub fn bits(value: f32) -> u32 {
    value.to_bits()
}

/// Runs a kernel that writes one new array of `len` numbers.
pub fn one(
    gpu: &Gpu,
    kernel: &Kernel,
    reads: &[&Buffer],
    len: usize,
    words: &[u32],
    groups: [u32; 3],
    operations: u64,
) -> Buffer {
    let out = gpu.buffer(len);
    let arrays: Vec<&Buffer> = reads.iter().copied().chain([&out]).collect();
    let groups = if len == 0 { [0; 3] } else { groups };
    gpu.run(&Job {
        kernel,
        arrays: &arrays,
        words,
        groups,
        operations,
    });
    out
}
