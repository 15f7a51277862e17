//! The kernels' own transform: G w G^T.
#![allow(unsafe_code)]

use super::super::extents::{BLOCK, SIGHT, SPOTS};
use super::super::quads::{Quads, VectorKernel};
use super::super::transform::kernel_transform;

/// G from both sides of the kernels of a block of outputs and some channels.
pub struct TransformTaps<'a> {
    /// (C, 9, R), of these channels.
    pub taps: &'a [f32],
    /// Whether the taps are used in reverse.
    pub reverse: bool,
    /// (S, C, R), of all channels.
    pub spots: &'a mut [f32],
    /// The first of these channels among all.
    pub first: usize,
    pub channels: usize,
}

impl VectorKernel for TransformTaps<'_> {
    #[inline(always)]
    unsafe fn run<V: Quads>(mut self) {
        let count = self.taps.len() / (9 * BLOCK);
        assert!(
            self.first + count <= self.channels
                && self.spots.len() == SPOTS * self.channels * BLOCK,
            "winograd: the kernels' extents disagree"
        );
        for channel in 0..count {
            for lane in (0..BLOCK).step_by(V::LANES) {
                // SAFETY: by the contract of the trait, and the extents above.
                unsafe { self.channel::<V>(channel, lane) }
            }
        }
    }
}

impl TransformTaps<'_> {
    /// As many outputs as a vector has lanes, from `lane` on.
    /// SAFETY: that of [`VectorKernel::run`]; the channel is one of these.
    #[inline(always)]
    unsafe fn channel<V: Quads>(&mut self, channel: usize, lane: usize) {
        // SAFETY: by the contract of this function.
        unsafe {
            let taps = self.taps.as_ptr().add(channel * 9 * BLOCK + lane);
            // Loops, not closures: a closure that is not inlined is compiled without the vector's
            // instructions, so that each of its operations becomes a call.
            let mut w = [[V::splat(0.0); 3]; 3];
            for (column, w) in w.iter_mut().enumerate() {
                for (row, w) in w.iter_mut().enumerate() {
                    let forward = 3 * row + column;
                    let tap = if self.reverse { 8 - forward } else { forward };
                    *w = V::load(taps.add(tap * BLOCK));
                }
            }
            let [left, middle, right] = w;
            let left = kernel_transform(left);
            let middle = kernel_transform(middle);
            let right = kernel_transform(right);
            for line in 0..SIGHT {
                let along = kernel_transform([left[line], middle[line], right[line]]);
                for (column, value) in along.iter().enumerate() {
                    let place = (line * SIGHT + column) * self.channels + self.first + channel;
                    value.store(self.spots.as_mut_ptr().add(place * BLOCK + lane));
                }
            }
        }
    }
}
