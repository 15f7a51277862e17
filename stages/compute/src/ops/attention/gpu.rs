//! Attention by tiles: no score matrix exists in device memory, forward or backward.

use super::extents::Extents;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::job::Job;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::{folded, one};
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

const TILES: &str = include_str!("attention.wgsl");
const BACKWARD: &str = include_str!("attention_backward.wgsl");

/// Rows of a tile, and features of a slice.
const SIDE: usize = 64;

params! {
    /// The extents of one attention, as the tiles need them.
    struct Scores {
        queries: u32,
        keys: u32,
        heads: u32,
        /// Features of one head.
        depth: u32,
        /// What scores are multiplied by.
        scale: f32,
        /// 1 if queries see no later key.
        causal: u32,
    }
}

params! {
    /// Rows of products that are summed, each of `depth` numbers.
    struct Deltas {
        rows: u32,
        depth: u32,
    }
}

impl Scores {
    fn new(e: Extents) -> Scores {
        Scores {
            queries: e.queries as u32,
            keys: e.keys as u32,
            heads: e.heads as u32,
            depth: e.depth as u32,
            scale: e.scale(),
            causal: e.causal.into(),
        }
    }
}

/// How many slices of a head's features one workgroup sums, `most` at most, and the workgroups for
/// `tokens` rows.
fn shape(e: Extents, tokens: usize, most: usize) -> (u32, [u32; 3]) {
    let slices = e.depth.div_ceil(SIDE);
    let each = slices.clamp(1, most);
    let groups = [
        tokens.div_ceil(SIDE),
        e.batch * e.heads,
        slices.div_ceil(each),
    ];
    // Deep heads take several workgroups along z, each of which computes all scores anew.
    (each as u32, groups.map(|count| count as u32))
}

/// Multiplications and additions of one product of all scores, of which forward has two and
/// backward five.
fn operations(e: Extents) -> u64 {
    2 * (e.batch * e.heads * e.queries * e.keys * e.depth) as u64
}

/// The attended values, and the logarithm of the sum of the exponentials of each query's scores.
pub fn forward(gpu: &Gpu, [q, k, v]: [&Buffer; 3], e: Extents) -> [Buffer; 2] {
    // Four slices are 64 sums in each invocation's registers.
    let (slices, groups) = shape(e, e.queries, 4);
    let kernel = Kernel::new(
        "attention",
        &[TILES, include_str!("attention_forward.wgsl")],
        [3, 2],
    );
    let kernel = kernel.with(&[("SLICES", slices)]);
    let rows = e.batch * e.queries * e.heads;
    let [out, lse] = [rows * e.depth, rows].map(|len| gpu.buffer(len));
    let arrays = [q, k, v, &out, &lse];
    gpu.run(&Job {
        kernel: &kernel,
        arrays: &arrays,
        params: Scores::new(e),
        groups,
        operations: 2 * operations(e),
    });
    [out, lse]
}

/// The gradients to queries, keys and values, given the output, its sums and the gradient to it.
pub fn backward(
    gpu: &Gpu,
    [q, k, v]: [&Buffer; 3],
    [out, lse, dout]: [&Buffer; 3],
    e: Extents,
) -> [Buffer; 3] {
    let rows = e.batch * e.queries * e.heads;
    let kernel = Kernel::new(
        "attention_delta",
        &[include_str!("attention_delta.wgsl")],
        [2, 1],
    );
    let groups = folded(rows.div_ceil(256));
    let delta = one(
        gpu,
        &kernel,
        &[out, dout],
        rows,
        Deltas {
            rows: rows as u32,
            depth: e.depth as u32,
        },
        groups,
        2 * (rows * e.depth) as u64,
    );
    let reads = [q, k, v, dout, lse, &delta];
    let dq = queries(gpu, reads, e);
    let [dk, dv] = keys(gpu, reads, e);
    [dq, dk, dv]
}

fn queries(gpu: &Gpu, reads: [&Buffer; 6], e: Extents) -> Buffer {
    let (slices, groups) = shape(e, e.queries, 4);
    let templates = &[TILES, BACKWARD, include_str!("attention_queries.wgsl")];
    let kernel = Kernel::new("attention_queries", templates, [6, 1]).with(&[("SLICES", slices)]);
    let len = e.batch * e.queries * e.heads * e.depth;
    one(
        gpu,
        &kernel,
        &reads,
        len,
        Scores::new(e),
        groups,
        3 * operations(e),
    )
}

fn keys(gpu: &Gpu, reads: [&Buffer; 6], e: Extents) -> [Buffer; 2] {
    // Two sums a slice, to keys and to values, so half as many slices fit the registers.
    let (slices, groups) = shape(e, e.keys, 2);
    let templates = &[TILES, BACKWARD, include_str!("attention_keys.wgsl")];
    let kernel = Kernel::new("attention_keys", templates, [6, 2]).with(&[("SLICES", slices)]);
    let len = e.batch * e.keys * e.heads * e.depth;
    let [dk, dv] = [0; 2].map(|_| gpu.buffer(len));
    let arrays: Vec<&Buffer> = reads.into_iter().chain([&dk, &dv]).collect();
    gpu.run(&Job {
        kernel: &kernel,
        arrays: &arrays,
        params: Scores::new(e),
        groups,
        operations: 4 * operations(e),
    });
    [dk, dv]
}
