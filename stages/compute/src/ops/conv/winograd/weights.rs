//! Transformed kernels, packed for the products. It knows how weights are stored, and no images.

use std::ops::Range;

use rayon::prelude::*;

use super::extents::{BLOCK, SPOTS};
use super::kernels::TransformTaps;
use super::quads::run;
use crate::ops::conv::geometry::Geometry;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::transpose::transpose_into;
use crate::runtime::cpu::values::Values;

/// Channels whose taps are sorted at a time: they stay in the first cache.
const GROUP: usize = 16;

/// Which way the kernels are used.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// `[O, C, 3, 3]` as they are.
    Forward,
    /// As the gradient to the input uses them: `[C, O]`, with the taps in reverse.
    Backward,
}

/// The kernels of a convolution as a weight stores them.
#[derive(Clone, Copy)]
pub struct StoredKernels<'a> {
    pub values: Values<'a>,
    pub direction: Direction,
    pub channels: usize,
    pub outputs: usize,
}

/// Transformed kernels (B, S, C, R): of B blocks of R = [`BLOCK`] outputs, at each of S spots.
#[derive(Clone, Copy)]
pub struct Kernels<'a> {
    values: &'a [f32],
    channels: usize,
}

impl<'a> StoredKernels<'a> {
    pub fn new(values: Values<'a>, direction: Direction, g: &Geometry) -> Self {
        StoredKernels {
            values,
            direction,
            channels: g.channels,
            outputs: g.outputs,
        }
    }

    /// All kernels, transformed by all threads, as [`Kernels`] sees them.
    pub fn transform(&self) -> HostBuffer {
        let block = SPOTS * self.channels * BLOCK;
        let mut values = HostBuffer::uninitialised(self.outputs.div_ceil(BLOCK) * block);
        values
            .par_chunks_mut(block)
            .enumerate()
            .for_each(|(i, out)| {
                let outputs = i * BLOCK..self.outputs.min((i + 1) * BLOCK);
                self.transform_block(outputs, 0..self.channels, out);
            });
        values
    }

    /// The kernels of some outputs (whole blocks, but for the last) and channels, transformed by
    /// the calling thread.
    pub fn transform_part(&self, outputs: Range<usize>, channels: Range<usize>) -> HostBuffer {
        let block = SPOTS * channels.len() * BLOCK;
        let mut values = HostBuffer::uninitialised(outputs.len().div_ceil(BLOCK) * block);
        for (i, out) in values.chunks_mut(block).enumerate() {
            let first = outputs.start + i * BLOCK;
            let outputs = first..outputs.end.min(first + BLOCK);
            self.transform_block(outputs, channels.clone(), out);
        }
        values
    }

    /// Those of a single block (S, C, R). Outputs that are missing from it are zero.
    fn transform_block(&self, outputs: Range<usize>, channels: Range<usize>, out: &mut [f32]) {
        let mut taps = [0.0; BLOCK * GROUP * 9];
        // Zeros, for the outputs that the last block lacks.
        let mut sorted = [0.0; GROUP * 9 * BLOCK];
        for first in channels.clone().step_by(GROUP) {
            let group = first..channels.end.min(first + GROUP);
            self.sort_taps(outputs.clone(), group.clone(), &mut taps, &mut sorted);
            run(TransformTaps {
                taps: &sorted[..group.len() * 9 * BLOCK],
                reverse: self.direction == Direction::Backward,
                spots: out,
                first: first - channels.start,
                channels: channels.len(),
            });
        }
    }

    /// Taps as (C, 9, R): a vector is one tap of many outputs. `taps` is space.
    fn sort_taps(
        &self,
        outputs: Range<usize>,
        channels: Range<usize>,
        taps: &mut [f32],
        sorted: &mut [f32],
    ) {
        let rows = outputs.len();
        match self.direction {
            Direction::Forward => {
                // (R, C, 9)
                let len = channels.len() * 9;
                for (output, taps) in outputs.zip(taps.chunks_mut(len)) {
                    let first = (output * self.channels + channels.start) * 9;
                    // Weights of 16 bits are widened here, group by group, and never as a whole.
                    self.values.widen(first, taps);
                }
                transpose_into(taps, len, [rows, len], sorted, BLOCK);
            }
            Direction::Backward => {
                // (C, R, 9)
                for (channel, sorted) in channels.zip(sorted.chunks_mut(9 * BLOCK)) {
                    let taps = &mut taps[..rows * 9];
                    let first = (channel * self.outputs + outputs.start) * 9;
                    self.values.widen(first, taps);
                    transpose_into(taps, 9, [rows, 9], sorted, BLOCK);
                }
            }
        }
    }
}

impl<'a> Kernels<'a> {
    /// What [`StoredKernels`] transformed, of so many channels.
    pub fn new(values: &'a [f32], channels: usize) -> Self {
        Kernels { values, channels }
    }

    /// Those of one block at one spot, (C, R), of the channels of `depth`.
    pub fn at(&self, block: usize, spot: usize, depth: Range<usize>) -> &'a [f32] {
        let first = (block * SPOTS + spot) * self.channels;
        &self.values[(first + depth.start) * BLOCK..(first + depth.end) * BLOCK]
    }
}
