//! Convolution as products of matrices: panels of the column matrix (im2col) are packed from the
//! image when they are needed, and forgotten.

use std::ops::Range;

use super::buffer::Buffer;
use super::factor::{DEPTH, GRAIN, Right, Stored, Turned};
use super::map;
use super::matrix::{Cut, Matrix};
use super::product::{Packed, Start, add_product, cut, product};
use super::tile::{COLUMNS, Old};
use super::transpose::transpose_into;
use super::weight::Values;
use super::winograd::{self, Direction};
use crate::conv::{Conv, Finish, Geometry};
use crate::weight::{Precision, Weight};

/// The fewest channels per task of the general gradient to the input.
const CHANNELS: usize = 8;
/// Tasks of it per image, about.
const TASKS: usize = 16;
/// Elements of the column matrix's gradient that a task holds, if it has more than the fewest
/// channels.
const HELD: usize = 1 << 16;

impl Geometry {
    pub fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    pub fn pixels(&self) -> usize {
        self.out_height * self.out_width
    }

    pub fn plane(&self) -> usize {
        self.height * self.width
    }

    /// Whether the column matrix is the image itself.
    fn is_pointwise(&self) -> bool {
        self.kernel == [1, 1] && self.conv == Conv::default()
    }

    /// The same convolution of images of a single row, if it is [pointwise](Self::is_pointwise).
    fn flat(&self) -> Geometry {
        if !self.is_pointwise() {
            return *self;
        }
        Geometry {
            height: 1,
            width: self.plane(),
            out_height: 1,
            out_width: self.pixels(),
            ..*self
        }
    }

    /// The convolution by which gradients flow back, if that is one: of stride 1, with the kernel
    /// turned around.
    fn turned(&self) -> Option<Geometry> {
        let [kh, kw] = self.kernel;
        let [top, bottom, left, right] = self.conv.pad;
        let pad = [
            kh.checked_sub(1 + top)?,
            kh.checked_sub(1 + bottom)?,
            kw.checked_sub(1 + left)?,
            kw.checked_sub(1 + right)?,
        ];
        (self.conv.stride == 1).then_some(Geometry {
            channels: self.outputs,
            outputs: self.channels,
            height: self.out_height,
            width: self.out_width,
            out_height: self.height,
            out_width: self.width,
            conv: Conv { stride: 1, pad },
            ..*self
        })
    }
}

/// Where one tap sees the image: a run of `len` output pixels of a panel reads the plane from
/// `source` on.
struct Run {
    target: usize,
    source: usize,
    len: usize,
}

/// The runs of the tap (`ky`, `kx`) over `pixels`, which lie in the image; the other pixels see
/// padding.
fn runs(g: &Geometry, [ky, kx]: [usize; 2], pixels: Range<usize>) -> impl Iterator<Item = Run> {
    let g = *g;
    let stride = g.conv.stride;
    let [top, _, left, _] = g.conv.pad;
    // Outputs begin..end of a row see the image.
    let begin = left.saturating_sub(kx).div_ceil(stride).min(g.out_width);
    let end = (g.width + left)
        .saturating_sub(kx)
        .div_ceil(stride)
        .clamp(begin, g.out_width);
    (pixels.start / g.out_width..pixels.end.div_ceil(g.out_width)).filter_map(move |y| {
        let row = (y * stride + ky).wrapping_sub(top);
        let first = pixels.start.max(y * g.out_width + begin);
        let last = pixels.end.min(y * g.out_width + end);
        let source = || row * g.width + (first - y * g.out_width) * stride + kx - left;
        (row < g.height && first < last).then(|| Run {
            target: first - pixels.start,
            source: source(),
            len: last - first,
        })
    })
}

#[inline(always)]
fn copy_run(run: &Run, plane: &[f32], stride: usize, out: &mut [f32]) {
    let source = &plane[run.source..];
    let target = &mut out[run.target..run.target + run.len];
    match stride {
        1 if run.len == COLUMNS => target.copy_from_slice(&source[..COLUMNS]),
        1 => target
            .iter_mut()
            .zip(source)
            .for_each(|(target, source)| *target = *source),
        2 => {
            // Pairs become vectors; the last value may have no second one.
            let last = run.len - 1;
            let before = &mut target[..last];
            before
                .iter_mut()
                .zip(source.as_chunks::<2>().0)
                .for_each(|(target, pair)| *target = pair[0]);
            target[last] = source[2 * last];
        }
        _ => target
            .iter_mut()
            .zip(source.iter().step_by(stride))
            .for_each(|(target, source)| *target = *source),
    }
}

/// The column matrices of some images: row (channel, tap), column pixel.
struct Patches<'a> {
    images: &'a [f32],
    g: Geometry,
}

impl Patches<'_> {
    /// The rows `depth` of one image's column matrix at `pixels`: each `width` elements after the
    /// one before.
    fn rows(
        &self,
        image: usize,
        depth: Range<usize>,
        pixels: Range<usize>,
        width: usize,
        out: &mut [f32],
    ) {
        let g = &self.g;
        let taps = g.taps();
        let image = &self.images[image * g.channels * g.plane()..][..g.channels * g.plane()];
        for row in depth.start..depth.end.min(depth.start + taps) {
            let tap = row % taps;
            let runs: Vec<Run> =
                runs(g, [tap / g.kernel[1], tap % g.kernel[1]], pixels.clone()).collect();
            let padded = runs.iter().map(|run| run.len).sum::<usize>() < pixels.len();
            for row in (row..depth.end).step_by(taps) {
                let out = &mut out[(row - depth.start) * width..][..pixels.len()];
                if padded {
                    out.fill(0.0);
                }
                let plane = &image[row / taps * g.plane()..][..g.plane()];
                runs.iter()
                    .for_each(|run| copy_run(run, plane, g.conv.stride, out));
            }
        }
    }
}

impl Right for Patches<'_> {
    fn grain(&self) -> usize {
        if self.g.taps() == 1 { GRAIN } else { DEPTH }
    }

    fn pack(&self, image: usize, pixels: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        self.rows(image, depth, pixels, COLUMNS, panel);
    }
}

/// The transposed column matrix of the image of that number.
struct TurnedPatches<'a>(Patches<'a>, usize);

impl Right for TurnedPatches<'_> {
    fn pack(&self, _: usize, rows: Range<usize>, pixels: Range<usize>, panel: &mut [f32]) {
        let TurnedPatches(patches, image) = self;
        let mut turned = [0.0; COLUMNS * DEPTH];
        patches.rows(*image, rows.clone(), pixels.clone(), DEPTH, &mut turned);
        transpose_into(&turned, DEPTH, [rows.len(), pixels.len()], panel, COLUMNS);
    }
}

/// `weight [O, C, kh, kw]` over every image of `x`, plus `bias`, finished.
pub fn forward(
    x: &[f32],
    weight: &Weight,
    bias: Option<&[f32]>,
    finish: Finish<&[f32]>,
    g: &Geometry,
) -> Buffer {
    if winograd::suits(g) {
        let task = winograd::Task { g, x, bias, finish };
        let stored = winograd::Stored::new(weight.host(), Direction::Forward, g);
        return winograd::convolve(&task, stored, weight.transformed());
    }
    let mut out = forward_by_product(x, weight, bias, g);
    map::finish(&mut out, finish);
    out
}

fn forward_by_product(x: &[f32], weight: &Weight, bias: Option<&[f32]>, g: &Geometry) -> Buffer {
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

/// The gradient to the input.
pub fn backward_input(
    dy: &[f32],
    (weight, precision): (Values, Precision),
    g: &Geometry,
) -> Buffer {
    if let Some(turned) = g.turned().filter(winograd::suits) {
        let task = winograd::Task {
            g: &turned,
            x: dy,
            bias: None,
            finish: Finish::None,
        };
        let stored = winograd::Stored::new(weight, Direction::Backward, &turned);
        return winograd::convolve(&task, stored, None);
    }
    if let Some(turned) = g.turned().filter(Geometry::is_pointwise) {
        let weight = Turned(Stored {
            values: weight,
            columns: g.channels,
        });
        let right = Patches {
            images: dy,
            g: turned.flat(),
        };
        return product(
            [g.batch, g.channels, g.plane()],
            g.outputs,
            &weight,
            &right,
            Start::Zero,
            precision,
        );
    }
    backward_input_by_columns(dy, (weight, precision), g)
}

/// The general gradient to the input: rows of the column matrix's gradient, added back to where
/// they came from.
fn backward_input_by_columns(
    dy: &[f32],
    (weight, precision): (Values, Precision),
    g: &Geometry,
) -> Buffer {
    let taps = g.taps();
    let pixels = g.pixels();
    let share_rows = (HELD / (taps * pixels).max(1))
        .min(g.channels / TASKS)
        .max(CHANNELS);
    let mut dx = Buffer::zeros(g.batch * g.channels * g.plane());
    let planes = Cut {
        matrices: g.batch,
        rows: g.channels,
        columns: g.plane(),
        panel: g.plane(),
        share_rows,
        share_panels: 1,
    };
    planes.for_each_share(&mut dx, |mut share| {
        let channels = share.rows.clone();
        let image = share.panels.start;
        let values = weight.slice(channels.start * taps..weight.len());
        let kernels = Turned(Stored {
            values,
            columns: g.channels * taps,
        });
        let dy = Matrix::new(&dy[image * g.outputs * pixels..], g.outputs, pixels);
        let mut rows = Buffer::stale(channels.len() * taps * pixels);
        Packed::new(&dy, g.outputs, pixels, precision).multiply(
            &mut rows,
            channels.len() * taps,
            &kernels,
            Old::Forget,
        );
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

/// The adjoint of [`column_row`] over all pixels.
fn add_back(row: &[f32], g: &Geometry, [ky, kx]: [usize; 2], dx: &mut [f32]) {
    let [top, _, left, _] = g.conv.pad;
    let stride = g.conv.stride;
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

/// The gradient to the weight: over all images in their order, `dy` times the transposed column
/// matrix.
pub fn backward_weight(x: &[f32], dy: &[f32], g: &Geometry) -> Buffer {
    let g = g.flat();
    let rows = g.channels * g.taps();
    let mut dw = Buffer::stale(g.outputs * rows);
    cut([1, g.outputs, rows]).for_each_share(&mut dw, |mut share| {
        for image in 0..g.batch {
            let dy = Matrix::new(&dy[image * g.outputs * g.pixels()..], g.outputs, g.pixels());
            let patches = TurnedPatches(Patches { images: x, g }, image);
            let old = if image == 0 { Old::Forget } else { Old::Keep };
            add_product(&mut share, &dy, &patches, g.pixels(), (old, Precision::F32));
        }
    });
    dw
}
