//! Group and layer normalisation, forward and backward to the input.

use super::groups::{Activation, Groups};
use crate::runtime::gpu::context::{Gpu, Job};
use crate::runtime::gpu::each::MATH;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::{bits, folded, one};
use crate::runtime::gpu::pool::Buffer;

const SUMS: &str = include_str!("norm.wgsl");
const LAYER: &str = include_str!("layer_norm.wgsl");
const GROUP: &str = include_str!("group_norm.wgsl");
const SLOPE: &str = include_str!("group_slope.wgsl");

/// Elements of a group that one workgroup takes.
const CHUNK: usize = 4096;

/// A group normalisation being launched: the moments of its chunks, and how they lie.
struct Launch {
    moments: Buffer,
    words: [u32; 6],
    groups: [u32; 3],
    /// Chunks of all groups.
    chunks: usize,
    head: String,
}

impl Launch {
    fn new(gpu: &Gpu, x: &Buffer, len: usize, g: Groups, activation: Activation) -> Launch {
        let channels = g.channels / g.groups;
        let size = channels * g.plane;
        let count = len / size.max(1);
        let chunks = size.div_ceil(CHUNK);
        let groups = [chunks as u32, count as u32, 1];
        let kernel = Kernel::new(
            "group_moments",
            &[SUMS, include_str!("group_moments.wgsl")],
            [1, 1],
        );
        let words = [size as u32, chunks as u32];
        let moments = one(
            gpu,
            &kernel,
            &[x],
            2 * chunks * count,
            &words,
            groups,
            4 * len as u64,
        );
        let [plane, channels, images] = [g.plane, channels, g.groups].map(|extent| extent as u32);
        let words = [words[0], words[1], plane, channels, images, bits(g.eps)];
        let (activate, slope) = match activation {
            Activation::None => ("x", "1.0"),
            Activation::Silu => ("silu(x)", "silu_slope(x)"),
        };
        let head = format!(
            "{MATH}\nfn activate(x: f32) -> f32 {{ return {activate}; }}\n\
             fn activation_slope(x: f32) -> f32 {{ return {slope}; }}\n"
        );
        Launch {
            moments,
            words,
            groups,
            chunks: chunks * count,
            head,
        }
    }
}

/// `x` normalised group by group, scaled, shifted and activated.
pub fn group(
    gpu: &Gpu,
    x: &Buffer,
    [gamma, beta]: [&Buffer; 2],
    len: usize,
    g: Groups,
    activation: Activation,
) -> Buffer {
    let launch = Launch::new(gpu, x, len, g, activation);
    let kernel = Kernel::new(
        "group_norm",
        &[SUMS, GROUP, include_str!("group_forward.wgsl")],
        [4, 1],
    );
    let reads = [x, gamma, beta, &launch.moments];
    one(
        gpu,
        &kernel.having(launch.head),
        &reads,
        len,
        &launch.words,
        launch.groups,
        8 * len as u64,
    )
}

/// The gradient of [`group`] to `x`.
pub fn group_backward(
    gpu: &Gpu,
    [x, dy]: [&Buffer; 2],
    [gamma, beta]: [&Buffer; 2],
    len: usize,
    g: Groups,
    activation: Activation,
) -> Buffer {
    let launch = Launch::new(gpu, x, len, g, activation);
    let kernel = Kernel::new(
        "group_sums",
        &[SUMS, GROUP, SLOPE, include_str!("group_sums.wgsl")],
        [5, 1],
    );
    let reads = [x, gamma, beta, &launch.moments, dy];
    let kernel = kernel.having(launch.head.clone());
    let sums = one(
        gpu,
        &kernel,
        &reads,
        2 * launch.chunks,
        &launch.words,
        launch.groups,
        12 * len as u64,
    );
    let templates = &[SUMS, GROUP, SLOPE, include_str!("group_backward.wgsl")];
    let kernel = Kernel::new("group_backward", templates, [6, 1]).having(launch.head);
    let reads = [x, gamma, beta, &launch.moments, dy, &sums];
    one(
        gpu,
        &kernel,
        &reads,
        len,
        &launch.words,
        launch.groups,
        14 * len as u64,
    )
}

/// Each row of `width` elements normalised, scaled and shifted.
pub fn layer(
    gpu: &Gpu,
    x: &Buffer,
    [gamma, beta]: [&Buffer; 2],
    len: usize,
    width: usize,
    eps: f32,
) -> Buffer {
    layer_kernel(gpu, [x, gamma, beta], len, width, eps, true)
}

/// The gradient of [`layer`] to `x`.
pub fn layer_backward(
    gpu: &Gpu,
    [x, dy]: [&Buffer; 2],
    gamma: &Buffer,
    len: usize,
    width: usize,
    eps: f32,
) -> Buffer {
    layer_kernel(gpu, [x, gamma, dy], len, width, eps, false)
}

fn layer_kernel(
    gpu: &Gpu,
    reads: [&Buffer; 3],
    len: usize,
    width: usize,
    eps: f32,
    forward: bool,
) -> Buffer {
    let constants = [
        ("FORWARD", u32::from(forward)),
        ("BACKWARD", u32::from(!forward)),
    ];
    let kernel = Kernel::new("layer_norm", &[SUMS, LAYER], [3, 1]).with(&constants);
    let rows = len / width.max(1);
    let out = gpu.buffer(len);
    let [x, gamma, other] = reads;
    gpu.run(&Job {
        kernel: &kernel,
        arrays: &[x, gamma, other, &out],
        words: &[width as u32, rows as u32, bits(eps)],
        groups: folded(rows),
        operations: 10 * len as u64,
    });
    out
}
