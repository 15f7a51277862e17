//! Convolution as implicit matrix products: tiles of the column matrix (im2col) are built in a small buffer per thread,
//! multiplied, and forgotten.

use std::ops::Range;

use super::gemm::{Matrix, MatrixMut, Threads, column_blocks, multiply};
use super::map::fill;
use crate::conv::{Conv, Geometry};

/// Output pixels per tile.
const PIXELS: usize = 512;
/// Rows of the column matrix per tile, about.
const ROWS: usize = 256;

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

    /// Channels per tile of the column matrix.
    fn channel_step(&self) -> usize {
        ROWS.div_ceil(self.taps())
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

/// The tile of the column matrix with the rows of `channels` and the columns of `pixels`, row-major in `buffer`.
fn columns<'a>(
    image: &'a [f32],
    g: &Geometry,
    channels: Range<usize>,
    pixels: Range<usize>,
    buffer: &'a mut Vec<f32>,
) -> Matrix<'a> {
    let (rows, width) = (channels.len() * g.taps(), pixels.len());
    if g.is_pointwise() {
        return Matrix::strided(&image[channels.start * g.plane() + pixels.start..], rows, width, g.plane());
    }
    buffer.resize(rows * width, 0.0);
    for (i, out) in buffer.chunks_mut(width).enumerate() {
        let (channel, tap) = (channels.start + i / g.taps(), i % g.taps());
        let plane = &image[channel * g.plane()..][..g.plane()];
        column_row(plane, g, [tap / g.kernel[1], tap % g.kernel[1]], pixels.start, out);
    }
    Matrix::new(buffer, rows, width)
}

/// `weight [O, C, kh, kw]` over every image of `x`, plus `bias`.
pub fn forward(x: &[f32], weight: &[f32], bias: Option<&[f32]>, g: &Geometry) -> Vec<f32> {
    let mut out = vec![0.0; g.batch * g.outputs * g.pixels()];
    let step = g.channel_step();
    column_blocks(&mut out, [g.outputs, g.pixels()], PIXELS, |image, first, mut out| {
        if let Some(bias) = bias {
            (0..g.outputs).for_each(|o| out.row(o).fill(bias[o]));
        }
        let image = &x[image * g.channels * g.plane()..];
        let mut buffer = Vec::new();
        for c in (0..g.channels).step_by(step) {
            let channels = c..g.channels.min(c + step);
            let kernel =
                Matrix::strided(&weight[c * g.taps()..], g.outputs, channels.len() * g.taps(), g.channels * g.taps());
            let tile = columns(image, g, channels, first..first + out.columns(), &mut buffer);
            multiply(&mut out, kernel, tile, bias.is_some() || c > 0, Threads::One);
        }
    });
    out
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
        let mut buffer = Vec::new();
        for image in 0..g.batch {
            let (x, dy) = (&x[image * g.channels * g.plane()..], &dy[image * g.outputs * pixels..]);
            for pixel in (0..pixels).step_by(PIXELS) {
                let tile = pixel..pixels.min(pixel + PIXELS);
                let dy = Matrix::strided(&dy[pixel..], g.outputs, tile.len(), pixels);
                let columns = columns(x, g, channels.clone(), tile, &mut buffer).transposed();
                multiply(&mut dw, dy, columns, image + pixel > 0, Threads::One);
            }
        }
    });
    dw
}
