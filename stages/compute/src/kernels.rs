//! What other crates write kernels of their own with: an open GPU, its buffers, and WGSL that is
//! expanded from templates.

use crate::runtime::gpu::each::fill;

pub use crate::runtime::gpu::context::Gpu;
pub use crate::runtime::gpu::job::Job;
pub use crate::runtime::gpu::kernel::Kernel;
pub use crate::runtime::gpu::launch::folded;
pub use crate::runtime::gpu::memory::Requested;
pub use crate::runtime::gpu::params::{Params, params};
pub use crate::runtime::gpu::pool::Buffer;

/// `len` numbers that are 0, be they whole or not.
pub fn zeros(gpu: &Gpu, len: usize) -> Buffer {
    fill(gpu, len, 0.0)
}
