//! The column matrix of a convolution (im2col), which never exists as a whole: panels of it are
//! packed from the image when they are needed, and forgotten.

use std::ops::Range;

use super::geometry::Geometry;
use crate::ops::product::cpu::factor::{DEPTH, GRAIN, Right};
use crate::ops::product::cpu::tile::COLUMNS;
use crate::runtime::cpu::transpose::transpose_into;

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
        // A row above the image wraps around to one beyond it, and is left out below.
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
pub struct Patches<'a> {
    /// `[N, C, H, W]`.
    pub images: &'a [f32],
    pub g: Geometry,
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
        // Tap by tap: all channels share a tap's runs.
        for row in depth.start..depth.end.min(depth.start + taps) {
            let tap = row % taps;
            let runs: Vec<Run> =
                runs(g, [tap / g.kernel[1], tap % g.kernel[1]], pixels.clone()).collect();
            // Only what padding touches is cleared first.
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
        // The rows of a pointwise column matrix are whole planes apart.
        if self.g.taps() == 1 { GRAIN } else { DEPTH }
    }

    fn packing(&self) -> usize {
        // Taps lie in short runs, some of which meet padding.
        if self.g.taps() == 1 { 1 } else { 4 }
    }

    fn pack(&self, image: usize, pixels: Range<usize>, depth: Range<usize>, panel: &mut [f32]) {
        self.rows(image, depth, pixels, COLUMNS, panel);
    }
}

/// The transposed column matrix of the image of that number.
pub struct TurnedPatches<'a>(pub Patches<'a>, pub usize);

impl Right for TurnedPatches<'_> {
    fn packing(&self) -> usize {
        // Gathered as patches are, and then turned.
        5
    }

    fn pack(&self, _: usize, rows: Range<usize>, pixels: Range<usize>, panel: &mut [f32]) {
        let TurnedPatches(patches, image) = self;
        let mut turned = [0.0; COLUMNS * DEPTH];
        patches.rows(*image, rows.clone(), pixels.clone(), DEPTH, &mut turned);
        transpose_into(&turned, DEPTH, [rows.len(), pixels.len()], panel, COLUMNS);
    }
}
