//! Separable resampling, one plane per task.

use super::filter::Taps;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::chunks::fill;
use crate::runtime::cpu::simd::vectorize;

/// Applies the horizontal taps to every row, then the vertical taps to every column, of planes `[h,
/// w]`.
pub fn separable(x: &[f32], [h, w]: [usize; 2], vertical: &Taps, horizontal: &Taps) -> HostBuffer {
    let height = vertical.windows.len();
    let width = horizontal.windows.len();
    let mut out = HostBuffer::uninitialised(x.len() / (h * w) * height * width);
    fill(&mut out, height * width, |plane, out| {
        // Rows first, into [h, width]: columns then go line by line, a vector of pixels at a time.
        let mut narrow = HostBuffer::uninitialised(h * width);
        x[plane * h * w..]
            .chunks(w)
            .zip(narrow.chunks_mut(width))
            .for_each(|(x, out)| along_row(x, horizontal, out));
        along_columns(&narrow, vertical, width, out);
    });
    out
}

fn along_row(x: &[f32], taps: &Taps, out: &mut [f32]) {
    for (out, window) in out.iter_mut().zip(&taps.windows) {
        *out = x[window.first..]
            .iter()
            .zip(&window.weights)
            .map(|(x, weight)| x * weight)
            .sum();
    }
}

fn along_columns(x: &[f32], taps: &Taps, width: usize, out: &mut [f32]) {
    for (out, window) in out.chunks_mut(width).zip(&taps.windows) {
        out.fill(0.0);
        for (&weight, x) in window
            .weights
            .iter()
            .zip(x[window.first * width..].chunks(width))
        {
            vectorize(
                #[inline(always)]
                || {
                    for (out, x) in out.iter_mut().zip(x) {
                        *out += weight * x;
                    }
                },
            );
        }
    }
}
