//! Arrays cut into chunks of fixed size for several threads. It knows no operation.

use rayon::prelude::*;

/// Elements per task: large enough to hide the cost of a task, small enough to stay in the first
/// cache.
pub const CHUNK: usize = 1 << 14;

/// Elements that one thread works through sooner than it wakes others.
const ALONE: usize = 2 * CHUNK;

/// Calls `kernel` with the number and the values of every chunk of `out`. How many threads there are
/// changes no chunk, and so no sum over one.
pub fn fill(out: &mut [f32], chunk: usize, kernel: impl Fn(usize, &mut [f32]) + Sync) {
    // Waking threads costs more than such work takes. The chunks are the same.
    if out.len() <= chunk.max(ALONE) {
        out.chunks_mut(chunk)
            .enumerate()
            .for_each(|(i, out)| kernel(i, out));
    } else {
        out.par_chunks_mut(chunk)
            .enumerate()
            .for_each(|(i, out)| kernel(i, out));
    }
}
