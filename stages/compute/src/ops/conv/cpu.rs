//! Convolution on the CPU: by Winograd's filtering where that pays, else as a product of the weight
//! and the column matrix, and the gradients of both.

use std::ops::Range;

use super::geometry::Geometry;
use super::patches::{Patches, TurnedPatches};
use super::turned::TurnedKernels;
use super::winograd;
use super::winograd::task::Task;
use super::winograd::weights::{Direction, StoredKernels};
use crate::ops::product::cpu::cut::cut;
use crate::ops::product::cpu::factor::{Left, Right, Stored, Turned};
use crate::ops::product::cpu::packed::Packed;
use crate::ops::product::cpu::product::{Start, add_product, product};
use crate::ops::product::cpu::tile::Old;
use crate::ops::product::finish::Finish;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::chunks::{CHUNK, fill};
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::share::Cut;
use crate::runtime::cpu::simd::vectorize;
use crate::runtime::cpu::values::Values;
use crate::runtime::format::Precision;
use crate::runtime::weight::Weight;

/// The fewest pixels, for each channel that patches are gathered of, that pay for turning kernels.
const PIXELS: usize = 12;
/// The fewest channels per task of the general gradient to the input.
const CHANNELS: usize = 8;
/// Tasks of it per image, about.
const TASKS: usize = 16;
/// How many rows ahead a weight is prefetched.
const AHEAD: usize = 16;
/// Elements of the column matrix's gradient that a task holds, if it has more than the fewest
/// channels.
const HELD: usize = 1 << 16;

/// `weight [O, C, kh, kw]` over every image of `x`, plus `bias`, finished.
pub fn forward(
    x: &[f32],
    weight: &Weight,
    bias: Option<&[f32]>,
    finish: Finish<&[f32]>,
    g: &Geometry,
) -> HostBuffer {
    // In f32 whatever precision is asked for (docs/operators.md).
    if winograd::suits(g, weight.transformed().is_some()) {
        let task = Task { g, x, bias, finish };
        let stored = StoredKernels::new(weight.host(), Direction::Forward, g);
        return winograd::convolve(&task, stored, weight.transformed());
    }
    let mut out = forward_by_product(x, weight, bias, g);
    apply(finish, &mut out);
    out
}

fn forward_by_product(
    x: &[f32],
    weight: &Weight,
    bias: Option<&[f32]>,
    g: &Geometry,
) -> HostBuffer {
    // A pointwise convolution sees one long row, whose runs are not cut at the image's edges.
    let g = g.flat();
    let depth = g.channels * g.taps();
    let precision = weight.precision();
    let weight = Stored {
        values: weight.host(),
        columns: depth,
    };
    let start = bias.map_or(Start::Zero, Start::Rows);
    product(
        [g.batch, g.outputs, g.pixels()],
        depth,
        &weight,
        &Patches { images: x, g },
        start,
        precision,
    )
}

/// Finishes what a convolution gave, in place.
fn apply(finish: Finish<&[f32]>, x: &mut [f32]) {
    if finish == Finish::None {
        return;
    }
    fill(x, CHUNK, |i, x| {
        vectorize(
            #[inline(always)]
            || match finish {
                Finish::None => (),
                Finish::Leaky(slope) => {
                    for x in x {
                        *x = if *x > 0.0 { *x } else { slope * *x };
                    }
                }
                Finish::Add(other) => {
                    for (x, other) in x.iter_mut().zip(&other[i * CHUNK..]) {
                        *x += other;
                    }
                }
            },
        );
    });
}

/// The gradient to the input.
pub fn backward_input(
    dy: &[f32],
    (weight, precision): (Values, Precision),
    g: &Geometry,
) -> HostBuffer {
    // The gradient is a convolution by the kernel turned around, where stride and padding allow it.
    if let Some(turned) = g.turned().filter(|turned| winograd::suits(turned, false)) {
        let task = Task {
            g: &turned,
            x: dy,
            bias: None,
            finish: Finish::None,
        };
        let stored = StoredKernels::new(weight, Direction::Backward, &turned);
        return winograd::convolve(&task, stored, None);
    }
    let stored = Stored {
        values: weight,
        columns: g.channels,
    };
    match g.turned() {
        Some(turned) if turned.is_pointwise() => {
            product_of_turned(dy, &Turned(stored), &turned, precision)
        }
        Some(turned) if suits_patches(&turned) => {
            let kernels = TurnedKernels::new(weight, &turned);
            product_of_turned(dy, &kernels, &turned, precision)
        }
        _ => backward_input_by_columns(dy, (weight, precision), g),
    }
}

/// Whether a gradient takes less time as the product of turned kernels and patches than by columns.
/// Patches are gathered of the channels that it reads, columns are added up for those that it
/// writes, which costs more; and kernels are turned again for every few pixels.
fn suits_patches(turned: &Geometry) -> bool {
    // Measured: from 64 channels to 4 an eighth of the time, from 4 to 64 more than twice as much.
    turned.channels <= 3 * turned.outputs
        && turned.batch * turned.plane() >= PIXELS * turned.channels
}

/// The gradient to the input as the product of the turned `kernels` and the column matrix of `dy`.
fn product_of_turned(
    dy: &[f32],
    kernels: &impl Left,
    turned: &Geometry,
    precision: Precision,
) -> HostBuffer {
    let g = turned.flat();
    product(
        [g.batch, g.outputs, g.pixels()],
        g.channels * g.taps(),
        kernels,
        &Patches { images: dy, g },
        Start::Zero,
        precision,
    )
}

/// The general gradient to the input: rows of the column matrix's gradient, added back to where
/// they came from.
fn backward_input_by_columns(
    dy: &[f32],
    (weight, precision): (Values, Precision),
    g: &Geometry,
) -> HostBuffer {
    let taps = g.taps();
    let pixels = g.pixels();
    let share_rows = (HELD / (taps * pixels).max(1))
        .min(g.channels / TASKS)
        .max(CHANNELS);
    // Zeros, since windows overlap and their gradients are added.
    let mut dx = HostBuffer::zeros(g.batch * g.channels * g.plane());
    let planes = Cut {
        matrices: g.batch,
        rows: g.channels,
        columns: g.plane(),
        panel: g.plane(),
        share_rows,
        share_panels: 1,
    };
    // A task has all taps of its channels: windows overlap, and nobody else adds to a pixel.
    planes.for_each_share(&mut dx, |mut share| {
        let channels = share.rows.clone();
        let image = share.panels.start;
        let dy = Matrix::new(&dy[image * g.outputs * pixels..], g.outputs, pixels);
        let dy = Packed::new(&dy, g.outputs, pixels, precision);
        let mut rows = HostBuffer::uninitialised(channels.len() * taps * pixels);
        let group = CHANNELS * taps;
        for (i, rows) in rows.chunks_mut((group * pixels).max(1)).enumerate() {
            let first = channels.start * taps + i * group;
            let count = rows.len() / pixels;
            let kernels = gather_columns(weight, g, first..first + count);
            let kernels = Matrix::new(&kernels, g.outputs, count).transposed();
            dy.multiply(rows, count, &kernels, Old::Forget);
        }
        let mut dx = share.block(0..channels.len(), image);
        for (i, row) in rows.chunks(pixels.max(1)).enumerate() {
            let channel = i / taps;
            let tap = i % taps;
            add_back(
                row,
                g,
                [tap / g.kernel[1], tap % g.kernel[1]],
                dx.row(channel),
            );
        }
    });
    dx
}

/// Copies some columns of `weight [O, (C, kh, kw)]` side by side: (O, columns). Read from where they
/// lie, its rows would crowd one set of the cache, since they are often a multiple of a page apart.
fn gather_columns(weight: Values, g: &Geometry, columns: Range<usize>) -> HostBuffer {
    let stride = g.channels * g.taps();
    let mut out = HostBuffer::uninitialised(g.outputs * columns.len());
    for (output, out) in out.chunks_mut(columns.len().max(1)).enumerate() {
        let first = output * stride + columns.start;
        weight.widen(first, out);
        let ahead = first + AHEAD * stride;
        weight.prefetch(ahead..ahead + out.len());
    }
    out
}

/// Adds one row of the column matrix's gradient, that of a tap, to the pixels that it was read from.
fn add_back(row: &[f32], g: &Geometry, [ky, kx]: [usize; 2], dx: &mut [f32]) {
    let [top, _, left, _] = g.conv.pad;
    let stride = g.conv.stride;
    for (y, row) in row.chunks(g.out_width).enumerate() {
        // Above the image this wraps around to a number that no image has rows for.
        let target = (y * stride + ky).wrapping_sub(top);
        if target < g.height {
            for (x, value) in row.iter().enumerate() {
                let column = (x * stride + kx).wrapping_sub(left);
                if column < g.width {
                    dx[target * g.width + column] += value;
                }
            }
        }
    }
}

/// The gradient to the weight: over all images in their order, `dy` times the transposed column
/// matrix.
pub fn backward_weight(x: &[f32], dy: &[f32], g: &Geometry) -> HostBuffer {
    let g = g.flat();
    let rows = g.channels * g.taps();
    let mut dw = HostBuffer::uninitialised(g.outputs * rows);
    let patches = |image| TurnedPatches(Patches { images: x, g }, image);
    cut([1, g.outputs, rows], patches(0).packing()).for_each_share(&mut dw, |mut share| {
        for image in 0..g.batch {
            let dy = Matrix::new(&dy[image * g.outputs * g.pixels()..], g.outputs, g.pixels());
            // Images one after the other: a sum cut between tasks would depend on their number.
            let old = if image == 0 { Old::Forget } else { Old::Keep };
            add_product(
                &mut share,
                &dy,
                &patches(image),
                g.pixels(),
                (old, Precision::F32),
            );
        }
    });
    dw
}
