//! Convolution as implicit matrix products: tiles of the column matrix (im2col) are built in a small buffer per thread,
//! multiplied, and forgotten.

use std::ops::Range;

use super::gemm::{Matrix, MatrixMut, Threads, column_blocks, multiply};
use super::map::fill;
use crate::conv::{Conv, Geometry};

/// Output pixels per task.
const TILE: usize = 512;
/// Output pixels per product: what a row of the widest kernel's registers holds. A panel this wide needs no packing.
const PANEL: usize = 64;
/// Rows of a panel, about: it should stay in the first cache.
const CHANNELS_TIMES_TAPS: usize = 144;
/// Output channels per product: with more, the `gemm` crate packs what needs no packing.
const OUTPUTS: usize = 48;

impl Geometry {
    fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    fn pixels(&self) -> usize {
        self.out_height * self.out_width
    }

    fn plane(&self) -> usize {
        self.height * self.width
    }

    /// Whether the column matrix is the image itself.
    fn is_pointwise(&self) -> bool {
        self.kernel == [1, 1] && self.conv == Conv::default()
    }
}

/// One row of the column matrix, `out` for the output pixels from `pixel` on: the input `plane` shifted by the tap
/// (`ky`, `kx`), zero beyond its edge.
fn column_row(plane: &[f32], g: &Geometry, [ky, kx]: [usize; 2], pixel: usize, out: &mut [f32]) {
    let ([top, _, left, _], stride) = (g.conv.pad, g.conv.stride);
    let (mut y, mut x, mut done) = (pixel / g.out_width, pixel % g.out_width, 0);
    // Outputs begin..end of a row see the image; the others see padding.
    let begin = left.saturating_sub(kx).div_ceil(stride).min(g.out_width);
    let end = (g.width + left).saturating_sub(kx).div_ceil(stride).clamp(begin, g.out_width);
    if stride == 1 && begin <= x && x + out.len() <= end && (y + ky).wrapping_sub(top) < g.height {
        // Within one row of the image and away from its edges: nearly every panel of a large image.
        let start = (y + ky - top) * g.width + x + kx - left;
        return out.copy_from_slice(&plane[start..start + out.len()]);
    }
    while done < out.len() {
        let run = (g.out_width - x).min(out.len() - done);
        let target = &mut out[done..done + run];
        let row = (y * stride + ky).wrapping_sub(top);
        if row < g.height {
            let (first, last) = (begin.clamp(x, x + run), end.clamp(x, x + run));
            target[..first - x].fill(0.0);
            target[last - x..].fill(0.0);
            if first < last {
                let source = &plane[row * g.width + first * stride + kx - left..];
                copy_strided(source, stride, &mut target[first - x..last - x]);
            }
        } else {
            target.fill(0.0);
        }
        (y, x, done) = (y + 1, 0, done + run);
    }
}

fn copy_strided(source: &[f32], stride: usize, target: &mut [f32]) {
    match stride {
        1 => target.copy_from_slice(&source[..target.len()]),
        _ => target.iter_mut().zip(source.iter().step_by(stride)).for_each(|(target, source)| *target = *source),
    }
}

/// The rows of the column matrix that belong to `channels`, for the `out`'s width of pixels from `pixel` on.
fn columns(image: &[f32], g: &Geometry, channels: Range<usize>, pixel: usize, width: usize, out: &mut [f32]) {
    for (i, out) in out.chunks_mut(width).enumerate() {
        let (channel, tap) = (channels.start + i / g.taps(), i % g.taps());
        let plane = &image[channel * g.plane()..][..g.plane()];
        column_row(plane, g, [tap / g.kernel[1], tap % g.kernel[1]], pixel, out);
    }
}

/// `weight [O, C, kh, kw]` over every image of `x`, plus `bias`.
pub fn forward(x: &[f32], weight: &[f32], bias: Option<&[f32]>, g: &Geometry) -> Vec<f32> {
    let mut out = vec![0.0; g.batch * g.outputs * g.pixels()];
    let weight = Matrix::new(weight, g.outputs, g.channels * g.taps());
    column_blocks(&mut out, [g.outputs, g.pixels()], TILE, |image, first, mut out| {
        (0..g.outputs).for_each(|o| out.row(o).fill(bias.map_or(0.0, |bias| bias[o])));
        let image = &x[image * g.channels * g.plane()..][..g.channels * g.plane()];
        if g.is_pointwise() {
            let image = Matrix::strided(&image[first..], g.channels, out.columns(), g.plane());
            multiply(&mut out, weight, image, true, Threads::One);
        } else {
            tile(image, weight, g, first, &mut out);
        }
    });
    out
}

/// Adds the convolution of one image at the pixels of `out`, which begin at `first`.
fn tile(image: &[f32], weight: Matrix, g: &Geometry, first: usize, out: &mut MatrixMut) {
    let step = CHANNELS_TIMES_TAPS.div_ceil(g.taps());
    let mut panel = vec![0.0; step * g.taps() * PANEL];
    for c in (0..g.channels).step_by(step) {
        let channels = c..g.channels.min(c + step);
        let weight = weight.columns(channels.start * g.taps()..channels.end * g.taps());
        for pixel in (0..out.columns()).step_by(PANEL) {
            let pixels = pixel..out.columns().min(pixel + PANEL);
            let rows = channels.len() * g.taps();
            let panel = &mut panel[..rows * pixels.len()];
            columns(image, g, channels.clone(), first + pixel, pixels.len(), panel);
            for o in (0..g.outputs).step_by(OUTPUTS) {
                let outputs = o..g.outputs.min(o + OUTPUTS);
                let panel = Matrix::new(panel, rows, pixels.len());
                let out = &mut out.block(outputs.clone(), pixels.clone());
                multiply(out, weight.rows(outputs), panel, true, Threads::One);
            }
        }
    }
}

/// The gradient to the input. With stride 1 it is itself a convolution, with the kernel turned around.
pub fn backward_input(dy: &[f32], weight: &[f32], g: &Geometry) -> Vec<f32> {
    let [kh, kw] = g.kernel;
    let [top, bottom, left, right] = g.conv.pad;
    if g.conv.stride == 1 && top.max(bottom) < kh && left.max(right) < kw {
        let pad = [kh - 1 - top, kh - 1 - bottom, kw - 1 - left, kw - 1 - right];
        let turned = Geometry {
            channels: g.outputs,
            outputs: g.channels,
            height: g.out_height,
            width: g.out_width,
            out_height: g.height,
            out_width: g.width,
            conv: Conv { stride: 1, pad },
            ..*g
        };
        return forward(dy, &turn(weight, g), None, &turned);
    }
    backward_input_strided(dy, weight, g)
}

/// `[O, C, kh, kw]` as `[C, O, kh, kw]` with both kernel axes reversed.
fn turn(weight: &[f32], g: &Geometry) -> Vec<f32> {
    let taps = g.taps();
    let mut out = vec![0.0; weight.len()];
    for (i, kernel) in weight.chunks(taps).enumerate() {
        let (o, c) = (i / g.channels, i % g.channels);
        let target = &mut out[(c * g.outputs + o) * taps..][..taps];
        target.iter_mut().zip(kernel.iter().rev()).for_each(|(target, value)| *target = *value);
    }
    out
}

/// The general gradient to the input: rows of the column matrix's gradient, added back to where they came from.
fn backward_input_strided(dy: &[f32], weight: &[f32], g: &Geometry) -> Vec<f32> {
    let (taps, pixels) = (g.taps(), g.pixels());
    let mut dx = vec![0.0; g.batch * g.channels * g.plane()];
    fill(&mut dx, g.plane(), |i, dx| {
        let (image, channel) = (i / g.channels, i % g.channels);
        let kernel = Matrix::strided(&weight[channel * taps..], g.outputs, taps, g.channels * taps).transposed();
        let dy = Matrix::new(&dy[image * g.outputs * pixels..], g.outputs, pixels);
        let mut rows = vec![0.0; taps * pixels];
        multiply(&mut MatrixMut::new(&mut rows, taps, pixels), kernel, dy, false, Threads::One);
        for (tap, row) in rows.chunks(pixels).enumerate() {
            add_back(row, g, [tap / g.kernel[1], tap % g.kernel[1]], dx);
        }
    });
    dx
}

/// The adjoint of [`column_row`] over all pixels.
fn add_back(row: &[f32], g: &Geometry, [ky, kx]: [usize; 2], dx: &mut [f32]) {
    let ([top, _, left, _], stride) = (g.conv.pad, g.conv.stride);
    for (y, row) in row.chunks(g.out_width).enumerate() {
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

/// The gradient to the weight: over all images and tiles of pixels in their order, `dy` times the transposed tile.
pub fn backward_weight(x: &[f32], dy: &[f32], g: &Geometry) -> Vec<f32> {
    let (taps, pixels) = (g.taps(), g.pixels());
    let mut dw = vec![0.0; g.outputs * g.channels * taps];
    let step = 64usize.div_ceil(taps);
    column_blocks(&mut dw, [g.outputs, g.channels * taps], step * taps, |_, first, mut dw| {
        let channels = first / taps..(first + dw.columns()) / taps;
        let mut tile = vec![0.0; dw.columns() * TILE];
        for image in 0..g.batch {
            let (x, dy) = (&x[image * g.channels * g.plane()..], &dy[image * g.outputs * pixels..]);
            for pixel in (0..pixels).step_by(TILE) {
                let width = TILE.min(pixels - pixel);
                let tile = &mut tile[..dw.columns() * width];
                columns(x, g, channels.clone(), pixel, width, tile);
                let dy = Matrix::strided(&dy[pixel..], g.outputs, width, pixels);
                let columns = Matrix::new(tile, dw.columns(), width).transposed();
                multiply(&mut dw, dy, columns, true, Threads::One);
            }
        }
    });
    dw
}
