//! The kernels of a convolution as its gradient to the input uses them: it is itself a convolution,
//! from outputs to channels, with every kernel turned around.

use std::ops::Range;

use super::geometry::Geometry;
use crate::ops::product::cpu::factor::{Left, TILE_STRIDE};
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::values::Values;

/// `[O, C, taps]` as the matrix `[C, (O, taps in reverse)]`.
pub struct TurnedKernels<'a> {
    values: Values<'a>,
    channels: usize,
    taps: usize,
}

impl<'a> TurnedKernels<'a> {
    /// Those of the convolution that `turned` leads back through.
    pub fn new(values: Values<'a>, turned: &Geometry) -> Self {
        TurnedKernels {
            values,
            channels: turned.outputs,
            taps: turned.taps(),
        }
    }
}

impl Left for TurnedKernels<'_> {
    fn tile<'a>(
        &'a self,
        rows: Range<usize>,
        depth: Range<usize>,
        space: &'a mut [f32],
    ) -> Matrix<'a> {
        let taps = self.taps;
        // An output's kernels for neighbouring channels lie in one piece.
        let mut kernels = vec![0.0; rows.len() * taps];
        for output in depth.start / taps..depth.end.div_ceil(taps) {
            let first = (output * self.channels + rows.start) * taps;
            self.values.widen(first, &mut kernels);
            let begin = depth.start.max(output * taps);
            let end = depth.end.min((output + 1) * taps);
            // The last taps come first.
            let seen = (output + 1) * taps - end..(output + 1) * taps - begin;
            for (kernel, space) in kernels.chunks(taps).zip(space.chunks_mut(TILE_STRIDE)) {
                turn(&kernel[seen.clone()], &mut space[begin - depth.start..]);
            }
        }
        Matrix::strided(space, rows.len(), depth.len(), TILE_STRIDE)
    }
}

/// Copies `values` in reverse.
#[inline(always)]
fn turn(values: &[f32], out: &mut [f32]) {
    // A kernel of 3x3 as a whole: its loop has a known length, and is unrolled.
    if let ([whole], []) = values.as_chunks::<9>()
        && let Some(out) = out.first_chunk_mut::<9>()
    {
        *out = std::array::from_fn(|i| whole[8 - i]);
        return;
    }
    for (out, value) in out.iter_mut().zip(values.iter().rev()) {
        *out = *value;
    }
}
