//! Rays through a field on a GPU: which samples are visible, their densities and colours, and the
//! composited rays. Knows nothing of pixels or losses.

use super::params::{Pass, Span};
use super::resident::Resident;
use crate::march::Segment;
use compute::kernels::{Buffer, Gpu, Job, Kernel, Params};
use std::ops::Range;

/// Samples that have room on the device at once.
const ROOM: usize = 1 << 20;
/// Rays that are traced at once at most.
const MOST_RAYS: usize = 1 << 18;
/// Rays that one workgroup of the ray termination kernel follows.
const RAYS_PER_GROUP: usize = 16;
/// Workgroups that take turns at the samples: enough for the largest GPUs, and the same for all.
pub const TURNS: u32 = 512;

/// Numbers of a ray on the device.
pub const RAY: usize = 16;

/// Rays on the device.
pub struct Rays {
    /// Number of rays.
    pub count: usize,
    /// Sixteen numbers each: origin and start; direction and end; jitter, pixel and number within
    /// the pixel; direction in the world.
    pub buffer: Buffer,
    /// Visible samples of each.
    pub seen: Buffer,
    /// Samples of each whose density a CPU would have computed.
    pub queried: Buffer,
    /// Eight numbers each: colour and transmittance; then distance and padding.
    pub outputs: Buffer,
}

/// Part of the rays, traced: samples and what was found there.
pub struct Traced {
    /// Distance, length, ray and weight of every sample, behind their number.
    pub samples: Buffer,
    /// Raw density and colours of every sample.
    pub raw: Buffer,
    /// Samples before those of each ray, and the number of all.
    pub before: Buffer,
    /// What the pass's kernels were told.
    pub pass: Pass,
}

/// The numbers of one ray.
pub fn ray(segment: &Segment, jitter: f32, pixel: usize, within: usize) -> [f32; RAY] {
    let [([a, b, c], start), ([x, y, z], end)] = [
        (segment.origin, segment.range[0]),
        (segment.direction, segment.range[1]),
    ];
    let [u, v, w] = segment.view;
    [
        a,
        b,
        c,
        start,
        x,
        y,
        z,
        end,
        jitter,
        // Exact: batches have at most 2^16 rays.
        pixel as f32,
        within as f32,
        0.0,
        u,
        v,
        w,
        0.0,
    ]
}

/// Runs a kernel whose work only the device knows.
pub fn start<P: Params>(gpu: &Gpu, kernel: &Kernel<P>, arrays: &[&Buffer], params: P, groups: u32) {
    gpu.start(&Job {
        kernel,
        arrays,
        params,
        groups: [groups, 1, 1],
        // Work depends on samples, of which the host does not know the number: `work` accounts for
        // it afterwards.
        operations: 0,
    });
}

/// Workgroups of 256 for `count` pieces of work.
pub fn by_256(count: usize) -> u32 {
    count.div_ceil(256) as u32
}

impl Rays {
    /// Moves rays to a device.
    pub fn new(gpu: &Gpu, numbers: &[f32]) -> Self {
        let count = numbers.len() / RAY;
        let buffer = gpu.upload(bytemuck::cast_slice(numbers));
        Self {
            count,
            buffer,
            seen: gpu.buffer(count),
            queried: gpu.buffer(count),
            outputs: gpu.buffer(8 * count),
        }
    }
}

impl Resident {
    /// How many rays can be traced at once.
    pub fn rays_at_once(&self) -> usize {
        // As if every ray had all its steps: only the device learns how many there are.
        (ROOM / self.most_steps).clamp(1, MOST_RAYS)
    }

    /// Traces some of the rays, as many as [`Resident::rays_at_once`] allows, and writes what they
    /// see.
    pub fn trace(&self, rays: &Rays, which: Range<usize>) -> Traced {
        let gpu = &*self.gpu;
        let programs = &self.programs;
        let count = which.len();
        let pass = self.pass(which.start, count);
        let field = [&self.levels, &self.table, &self.weights];
        let [levels, table, weights] = field;
        let termination = [&rays.buffer, &self.bits, levels, table, weights, &rays.seen];
        start(
            gpu,
            &programs.ray_termination,
            &termination,
            pass,
            count.div_ceil(RAYS_PER_GROUP) as u32,
        );
        let before = gpu.buffer(count + 1);
        start(
            gpu,
            &programs.scan,
            &[&rays.seen, &before],
            Span {
                len: pass.rays,
                first: pass.first,
            },
            1,
        );
        let room = count * self.most_steps;
        // One vector more, in front: it holds how many samples there are.
        let samples = gpu.buffer(4 * (1 + room));
        let raw = gpu.buffer(4 * room);
        // Samples are marched a second time instead of kept: only now is it known where each ray's
        // begin.
        let gather = [
            &rays.buffer,
            &self.bits,
            &rays.seen,
            &before,
            &samples,
            &rays.queried,
        ];
        start(gpu, &programs.gather, &gather, pass, by_256(count));
        start(
            gpu,
            &programs.shade,
            &[&rays.buffer, &samples, levels, table, weights, &raw],
            pass,
            TURNS,
        );
        start(
            gpu,
            &programs.composite,
            &[&before, &raw, &samples, &rays.outputs],
            pass,
            by_256(count),
        );
        Traced {
            samples,
            raw,
            before,
            pass,
        }
    }
}
