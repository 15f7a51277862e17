//! What other crates write kernels of their own with: an open GPU, its buffers, and WGSL that is
//! expanded from templates.

pub use crate::gpu::context::{Gpu, Job, Requested};
pub use crate::gpu::kernel::Kernel;
pub use crate::gpu::launch::{bits, folded};
pub use crate::gpu::pool::Buffer;

/// `len` numbers that are 0, be they whole or not.
pub fn zeros(gpu: &Gpu, len: usize) -> Buffer {
    crate::gpu::map::fill(gpu, len, 0.0)
}
