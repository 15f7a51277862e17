//! Batches of pixels on their way to a GPU: the same pixels and rays as on the CPU. Knows nothing
//! of what becomes of them.

use super::resident::Resident;
use super::trace::{RAY, Rays, ray};
use crate::march::Segment;
use crate::train::Trainer;
use compute::kernels::Buffer;
use rayon::prelude::*;
use std::ops::Range;

/// Numbers of a pixel on the device.
const PIXEL: usize = 8;

/// A batch on the device.
pub struct GpuBatch {
    /// The rays of all pixels, one pixel's behind the other's.
    pub rays: Rays,
    /// Of each pixel: the colour that it should have, its view's weight, the background, and how
    /// many rays it has.
    pub pixels: Buffer,
    /// Room for the loss and the squared error of each pixel.
    pub losses: Buffer,
    /// Pixels of the batch.
    pub count: usize,
    /// Rays that are traced together: those of whole pixels.
    pub passes: Vec<Range<usize>>,
}

impl GpuBatch {
    /// The next batch of a trainer.
    pub fn draw(trainer: &Trainer, resident: &Resident) -> Self {
        let gpu = &resident.gpu;
        let count = trainer.pixels as usize;
        let drawn: Vec<(Vec<[f32; RAY]>, [f32; PIXEL])> = (0..count)
            // In the pixels' order whatever the threads, since a parallel collection keeps it.
            .into_par_iter()
            .map(|element| pixel(trainer, element))
            .collect();
        let passes = passes(
            drawn.iter().map(|(rays, _)| rays.len()),
            resident.rays_at_once(),
        );
        let rays: Vec<f32> = drawn
            .iter()
            .flat_map(|(rays, _)| rays.as_flattened())
            .copied()
            .collect();
        let pixels: Vec<f32> = drawn.iter().flat_map(|(_, pixel)| pixel).copied().collect();
        Self {
            rays: Rays::new(gpu, &rays),
            pixels: gpu.upload(bytemuck::cast_slice(&pixels)),
            losses: gpu.buffer(2 * count),
            count,
            passes,
        }
    }
}

/// A pixel and its rays.
fn pixel(trainer: &Trainer, element: usize) -> (Vec<[f32; RAY]>, [f32; PIXEL]) {
    let Trainer {
        views,
        sampler,
        options,
        step,
        pixels,
        field,
        ..
    } = trainer;
    let mut pixel = sampler.pixel(views, (*step).into(), element as u64, (*pixels).into());
    if !options.random_background {
        pixel.background = [0.0; 3];
    }
    let view = &views[pixel.view];
    let sub_rays = sampler
        .sub_rays(pixel, view.supersample, (*step).into())
        .enumerate();
    let segment = |px, py| Segment::new(&field.space, &view.camera, px, py);
    let rays: Vec<_> = sub_rays
        .map(|(within, (px, py, jitter))| ray(&segment(px, py), jitter, element, within))
        .collect();
    let [r, g, b] = view.target(&pixel);
    let [x, y, z] = pixel.background;
    let count = rays.len() as f32;
    (rays, [r, g, b, view.weight, x, y, z, count])
}

/// Rays of whole pixels, at most so many together where a pixel has no more.
fn passes(pixels: impl Iterator<Item = usize>, at_once: usize) -> Vec<Range<usize>> {
    let mut passes: Vec<Range<usize>> = Vec::new();
    let mut end = 0;
    for rays in pixels {
        match passes.last_mut() {
            // Whole pixels, since a pixel's rays are compared with the photo together.
            Some(pass) if pass.len() + rays <= at_once => pass.end += rays,
            _ => passes.push(end..end + rays),
        }
        end += rays;
    }
    passes
}

#[cfg(test)]
mod tests {
    use super::passes;

    #[test]
    fn a_pass_takes_whole_pixels() {
        assert_eq!(
            passes([4, 4, 4, 1, 4].into_iter(), 8),
            [0..8, 8..13, 13..17]
        );
        assert_eq!(
            passes([9, 9, 1].into_iter(), 8),
            [0..9, 9..18, 18..19],
            "a pixel is never cut"
        );
        assert_eq!(passes(std::iter::empty(), 8), []);
    }
}
