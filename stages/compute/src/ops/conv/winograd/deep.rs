//! Many channels, or few tiles: transformed tiles are shared by tasks that each compute some
//! outputs, and kernels are transformed when they are needed, since all of them take four times the
//! weight's memory.

use std::ops::Range;

use super::extents::{BLOCK, COLUMNS, DEPTH, SPOTS, WIDEST};
use super::kernels::{Lines, Multiply};
use super::panel::{Panel, across, cut, down};
use super::quads::run;
use super::task::Task;
use super::weights::{Kernels, StoredKernels};
use crate::ops::product::cpu::tile::Old;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::matrix::MatrixMut;
use crate::runtime::cpu::share::{Cut, Share};

/// Tiles that are transformed before they are multiplied.
const TILES: usize = 4 * COLUMNS;
/// The most outputs per task: every transformed input is read once per task.
const OUTPUTS: usize = 3 * BLOCK;
/// Tasks for the outputs of few channels.
const TASKS: usize = 6;
/// Channels per task of the inputs' transform.
const CHANNELS: usize = 4;

/// Where transformed kernels come from.
pub enum TransformedKernels<'a> {
    /// All of them, transformed before.
    Whole(Kernels<'a>),
    /// They are transformed as they are needed.
    Parts(StoredKernels<'a>),
}

/// Convolves, by all threads.
pub fn convolve(task: &Task, source: &TransformedKernels) -> HostBuffer {
    let g = task.g;
    let mut out = HostBuffer::uninitialised(g.batch * g.outputs * g.pixels());
    let all = g.batch * down(g);
    // Whole blocks, since a block's kernels are packed side by side.
    let share_rows = g.outputs.div_ceil(TASKS).next_multiple_of(BLOCK);
    let cut = cut(g, share_rows.min(OUTPUTS), all);
    // So few tiles at a time that their transforms stay small beside the image.
    let step = (TILES / across(g)).max(1);
    for first in (0..all).step_by(step) {
        let panels: Vec<Panel> = Panel::all(g, first..all.min(first + step)).collect();
        let inputs = transform_inputs(task, &panels);
        cut.for_each_share(&mut out, |mut share| {
            let sums = multiply(task, &inputs, panels.len(), source, share.rows.clone());
            transform_back(task, &sums, &panels, &mut share);
        });
    }
    out
}

/// The transformed inputs: (panels, S, C, P).
fn transform_inputs(task: &Task, panels: &[Panel]) -> HostBuffer {
    let channels = task.g.channels;
    let mut out = HostBuffer::uninitialised(panels.len() * SPOTS * channels * COLUMNS);
    let cut = Cut {
        matrices: panels.len() * SPOTS,
        rows: channels,
        columns: COLUMNS,
        panel: COLUMNS,
        share_rows: CHANNELS,
        share_panels: panels.len() * SPOTS,
    };
    cut.for_each_share(&mut out, |mut share| {
        let mut lines = Lines::new();
        for (i, panel) in panels.iter().enumerate() {
            for (row, channel) in share.rows.clone().enumerate() {
                let mut spots = share.through(row, i * SPOTS..(i + 1) * SPOTS);
                panel.transform_inputs(task.x, channel, &mut lines, &mut spots);
            }
        }
    });
    out
}

/// The sums of some outputs: (panels, O, S, P), O being whole blocks.
fn multiply(
    task: &Task,
    inputs: &[f32],
    panels: usize,
    source: &TransformedKernels,
    outputs: Range<usize>,
) -> HostBuffer {
    let channels = task.g.channels;
    let rows = outputs.len().next_multiple_of(BLOCK);
    let mut sums = HostBuffer::uninitialised(panels * rows * SPOTS * COLUMNS + WIDEST);
    for first in (0..channels).step_by(DEPTH) {
        let depth = first..channels.min(first + DEPTH);
        // In the same steps of depth as `band`, so that both give the same bits.
        let old = if first == 0 { Old::Forget } else { Old::Keep };
        let part = match source {
            TransformedKernels::Parts(stored) => {
                stored.transform_part(outputs.clone(), depth.clone())
            }
            TransformedKernels::Whole(_) => HostBuffer::uninitialised(0),
        };
        let part = Kernels::new(&part, depth.len());
        let kernels = |block: usize, spot: usize| match source {
            TransformedKernels::Whole(all) => {
                all.at(outputs.start / BLOCK + block, spot, depth.clone())
            }
            TransformedKernels::Parts(_) => part.at(block, spot, 0..depth.len()),
        };
        let mut sums = MatrixMut::new(&mut sums, panels * rows, SPOTS * COLUMNS);
        // At one spot, kernels of all outputs and a panel's tiles stay in the first two caches.
        for spot in 0..SPOTS {
            let columns = spot * COLUMNS..(spot + 1) * COLUMNS;
            for panel in 0..panels {
                let start = ((panel * SPOTS + spot) * channels + depth.start) * COLUMNS;
                for block in 0..rows / BLOCK {
                    let row = panel * rows + block * BLOCK;
                    run(Multiply {
                        kernels: kernels(block, spot),
                        tiles: &inputs[start..],
                        sums: sums.block(row..row + BLOCK, columns.clone()),
                        old,
                    });
                }
            }
        }
    }
    sums
}

fn transform_back(task: &Task, sums: &[f32], panels: &[Panel], share: &mut Share) {
    let rows = share.rows.len().next_multiple_of(BLOCK);
    for (i, panel) in panels.iter().enumerate() {
        for row in 0..share.rows.len() {
            let spots = &sums[(i * rows + row) * SPOTS * COLUMNS..];
            let bias = task.bias(share.rows.start + row);
            panel.transform_outputs(spots, (share, row), bias, task.finish);
        }
    }
}
