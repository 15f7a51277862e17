//! Group and layer normalisation, forward and backward to the input.

use super::groups::{Activation, Groups};
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::MATH;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::{folded, one};
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

const SUMS: &str = include_str!("norm.wgsl");
const LAYER: &str = include_str!("layer_norm.wgsl");
const GROUP: &str = include_str!("group_norm.wgsl");
const SLOPE: &str = include_str!("group_slope.wgsl");

/// Elements of a group that one workgroup takes.
const CHUNK: usize = 4096;

params! {
    /// Groups cut into chunks.
    struct Chunks {
        /// Elements of a group.
        size: u32,
        /// Chunks of a group.
        chunks: u32,
        /// Elements of a channel.
        plane: u32,
        /// Channels of a group.
        channels: u32,
        /// Groups of an image.
        groups: u32,
        eps: f32,
    }
}

params! {
    /// Rows of so many elements.
    struct Rows {
        width: u32,
        rows: u32,
        eps: f32,
    }
}

/// A group normalisation being launched: the moments of its chunks, and how they lie.
struct Launch {
    moments: Buffer,
    params: Chunks,
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
        let params = Chunks {
            size: size as u32,
            chunks: chunks as u32,
            plane: g.plane as u32,
            channels: channels as u32,
            groups: g.groups as u32,
            eps: g.eps,
        };
        // A kernel of its own: a group takes many workgroups, which cannot wait for each other.
        let moments = one(
            gpu,
            &kernel,
            &[x],
            2 * chunks * count,
            params,
            groups,
            4 * len as u64,
        );
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
            params,
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
        launch.params,
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
    // For the same reason: each element's gradient needs sums over its whole group.
    let sums = one(
        gpu,
        &kernel,
        &reads,
        2 * launch.chunks,
        launch.params,
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
        launch.params,
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
    let params = Rows {
        width: width as u32,
        rows: rows as u32,
        eps,
    };
    one(
        gpu,
        &kernel,
        &reads,
        len,
        params,
        folded(rows),
        10 * len as u64,
    )
}
