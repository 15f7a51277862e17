//! How operators start kernels: what most of them have in common. It knows no operator.

use super::context::Gpu;
use super::job::Job;
use super::kernel::Kernel;
use super::params::Params;
use super::pool::Buffer;

/// Workgroups for `count` pieces of work, folded into two axes where one has not room enough.
pub fn folded(count: usize) -> [u32; 3] {
    // An axis has room for 65535 workgroups, and half of that is a power of two to count by.
    let rows = count.div_ceil(1 << 15);
    [
        if rows > 1 { 1 << 15 } else { count as u32 },
        rows as u32,
        1,
    ]
}

/// Runs a kernel that writes one new array of `len` numbers.
pub fn one<P: Params>(
    gpu: &Gpu,
    kernel: &Kernel<P>,
    reads: &[&Buffer],
    len: usize,
    params: P,
    groups: [u32; 3],
    operations: u64,
) -> Buffer {
    let out = gpu.buffer(len);
    let arrays: Vec<&Buffer> = reads.iter().copied().chain([&out]).collect();
    gpu.run(&Job {
        kernel,
        arrays: &arrays,
        params,
        // Nothing to write, though the buffer has room for one number.
        groups: if len == 0 { [0; 3] } else { groups },
        operations,
    });
    out
}
