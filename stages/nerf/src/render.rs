//! Images of a field: colour, depth and opacity for a camera. Knows nothing of training.

use crate::features::Features;
use crate::field::Field;
use crate::march::Segment;
use crate::pool::Pool;
use crate::ray_termination::{MIN_WEIGHT, RayTermination};
use crate::samples::Samples;
use crate::volume_rendering::{RayBundle, RayOutput, VolumeRenderer};
use formats::Camera;
use rayon::prelude::*;
use std::convert::Infallible;
use std::ops::Range;

/// Pixels one task renders at a time; fixed, so that images do not depend on the number of threads.
const PIXELS: usize = 256;
/// Rays that pass through the networks together: their activations stay in the second-level cache.
const RAYS_PER_BUNDLE: usize = 32;

/// Options of [`render`].
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOptions {
    /// Rays per pixel and axis, spread evenly over the pixel and averaged.
    pub supersample: u32,
    /// What shows where the field is transparent, in the field's colour space.
    pub background: [f32; 3],
}

impl RenderOptions {
    pub(crate) fn rays_per_pixel(&self) -> usize {
        (self.supersample.max(1) as usize).pow(2)
    }
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            supersample: 1,
            background: [0.0; 3],
        }
    }
}

/// An image of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Pixels in a row.
    pub width: u32,
    /// Rows of pixels.
    pub height: u32,
    /// Colours in the space the field was trained in (sRGB-encoded photos give sRGB), composited on
    /// the background: `height * width * 3` values.
    pub rgb: Vec<f32>,
    /// Mean depth along the view axis in world units, normalised by opacity: sum of w z over sum of
    /// w. Where the opacity is below 1/1000 there is nothing to have a depth, and it is the
    /// camera's far.
    pub depth: Vec<f32>,
    /// 1 - T_end, averaged over the pixel.
    pub opacity: Vec<f32>,
    /// Samples that passed through both networks.
    pub samples: usize,
}

/// Renders what a camera sees. Another size of the same view is [`Camera::scaled`].
pub fn render(field: &Field, camera: &Camera, options: &RenderOptions) -> Rendered {
    let Ok(rendered) = try_render::<Infallible>(field, camera, options, &|| Ok(()));
    rendered
}

/// Renders what a camera sees, unless `may_go_on`, which is called before every few hundred pixels,
/// returns an error, which is passed on.
pub fn try_render<E: Send>(
    field: &Field,
    camera: &Camera,
    options: &RenderOptions,
    may_go_on: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Rendered, E> {
    let pixels = camera.width as usize * camera.height as usize;
    let scratch = Pool::default();
    let chunk = |chunk: usize| {
        may_go_on()?;
        let range = chunk * PIXELS..pixels.min((chunk + 1) * PIXELS);
        let rays = segments(field, camera, options, range);
        Ok(scratch.lend(|renderer: &mut ChunkRenderer| {
            let pixels = renderer.pixels(field, rays, camera, options);
            (pixels, renderer.samples.t.len())
        }))
    };
    let chunks: Vec<(Vec<RenderedPixel>, usize)> = (0..pixels.div_ceil(PIXELS))
        .into_par_iter()
        .map(chunk)
        .collect::<Result<_, E>>()?;
    let samples = chunks.iter().map(|(_, samples)| samples).sum();
    let pixels = chunks.iter().flat_map(|(pixels, _)| pixels);
    Ok(image(camera, pixels, samples))
}

/// The image that pixels make up.
pub(crate) fn image<'p>(
    camera: &Camera,
    pixels: impl Iterator<Item = &'p RenderedPixel> + Clone,
    samples: usize,
) -> Rendered {
    Rendered {
        width: camera.width,
        height: camera.height,
        rgb: pixels.clone().flat_map(|pixel| pixel.rgb).collect(),
        depth: pixels.clone().map(|pixel| pixel.depth).collect(),
        opacity: pixels.map(|pixel| pixel.opacity).collect(),
        samples,
    }
}

/// Colour with the background, world depth along the view axis, and opacity of one pixel.
pub(crate) struct RenderedPixel {
    rgb: [f32; 3],
    depth: f32,
    opacity: f32,
}

/// The rays of some pixels, one pixel's behind the other's.
pub(crate) fn segments(
    field: &Field,
    camera: &Camera,
    options: &RenderOptions,
    pixels: Range<usize>,
) -> Vec<Segment> {
    let side = options.supersample.max(1) as usize;
    let segment = |pixel: usize, sub: usize| {
        let x = pixel % camera.width as usize;
        let y = pixel / camera.width as usize;
        // Sub-rays at the middles of equal parts of the pixel.
        let place = |pixel: usize, sub: usize| pixel as f64 + (sub as f64 + 0.5) / side as f64;
        Segment::new(
            &field.space,
            camera,
            place(x, sub % side),
            place(y, sub / side),
        )
    };
    pixels
        .flat_map(|pixel| (0..side * side).map(move |sub| segment(pixel, sub)))
        .collect()
}

/// Each pixel from the mean of its rays, which follow each other.
pub(crate) fn averages(
    outputs: &[RayOutput],
    segments: &[Segment],
    camera: &Camera,
    options: &RenderOptions,
) -> Vec<RenderedPixel> {
    let rays = options.rays_per_pixel();
    let pixels = outputs.chunks(rays).zip(segments.chunks(rays));
    pixels
        .map(|(outputs, segments)| average(outputs, segments, camera, options))
        .collect()
}

/// Renders some pixels, and keeps its arrays for the next ones.
#[derive(Default)]
struct ChunkRenderer {
    samples: Samples,
    termination: RayTermination,
    features: Features,
    volume: VolumeRenderer,
}

impl ChunkRenderer {
    fn pixels(
        &mut self,
        field: &Field,
        rays: Vec<Segment>,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Vec<RenderedPixel> {
        self.samples.clear();
        rays.into_iter()
            // Without jitter, so that an image is the same each time.
            .for_each(|segment| self.samples.march(field, segment, 0.0));
        averages(
            &self.outputs(field),
            &self.samples.segments,
            camera,
            options,
        )
    }

    /// The outputs of all rays that were marched, in their order.
    fn outputs(&mut self, field: &Field) -> Vec<RayOutput> {
        let Self {
            samples,
            termination,
            features,
            volume,
        } = self;
        // The volume's activations are free until its forward pass, and serve as scratch space.
        termination.run(
            field,
            samples,
            features,
            &mut volume.activations,
            MIN_WEIGHT,
        );
        let count = samples.rays.len();
        let mut outputs = Vec::with_capacity(count);
        for first in (0..count).step_by(RAYS_PER_BUNDLE) {
            let range = first..count.min(first + RAYS_PER_BUNDLE);
            let rays = RayBundle {
                samples,
                range,
                features,
                rows: &termination.rows,
            };
            outputs.extend_from_slice(volume.forward_from(field, &rays, &termination.geometry));
        }
        outputs
    }
}

fn average(
    outputs: &[RayOutput],
    segments: &[Segment],
    camera: &Camera,
    options: &RenderOptions,
) -> RenderedPixel {
    let share = 1.0 / outputs.len() as f32;
    let mut pixel = RenderedPixel {
        rgb: [0.0; 3],
        depth: 0.0,
        opacity: 0.0,
    };
    for (output, segment) in outputs.iter().zip(segments) {
        for ((sum, color), background) in
            pixel.rgb.iter_mut().zip(output.rgb).zip(options.background)
        {
            *sum += share * (color + output.transmittance * background);
        }
        let opacity = 1.0 - output.transmittance;
        pixel.opacity += share * opacity;
        if opacity > 0.0 {
            // Weighted by opacity: a sub-ray that sees nothing has no depth to add.
            pixel.depth += share * opacity * segment.depth(output.distance / opacity);
        }
    }
    pixel.depth = if pixel.opacity < 1e-3 {
        camera.far as f32
    } else {
        pixel.depth / pixel.opacity
    };
    pixel
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::{BOUNDS, small};
    use glam::{DMat4, DVec3};
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn rendering_ends_where_it_may_not_go_on() {
        let field = Field::new(&small(), BOUNDS, 7);
        let pose = DMat4::from_translation(DVec3::new(1.0, 0.5, 5.0));
        let camera = Camera::centered((64, 48), 60.0, pose, [0.5, 4.0]);
        let options = RenderOptions::default();
        let asked = AtomicUsize::new(0);
        let thrice = || match asked.fetch_add(1, Ordering::SeqCst) {
            0..3 => Ok(()),
            _ => Err("enough"),
        };
        let ended = try_render(&field, &camera, &options, &thrice);
        assert_eq!(ended, Err("enough"));
        let whole = try_render::<Infallible>(&field, &camera, &options, &|| Ok(()));
        assert_eq!(whole, Ok(render(&field, &camera, &options)));
    }
}
