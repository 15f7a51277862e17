//! Images of a field by a GPU. Knows nothing of training.

use super::resident::Resident;
use super::trace::{RAY, Rays, ray};
use crate::field::Field;
use crate::march::Segment;
use crate::render::{RenderOptions, Rendered, RenderedPixel, averages, image, segments};
use crate::volume_rendering::RayOutput;
use compute::Device;
use formats::Camera;
use rayon::prelude::*;
use std::convert::Infallible;

/// Rays that come back from the device together.
// What they see takes 32 bytes each, so that 8 MiB come back together.
const ROUND: usize = 1 << 18;

/// Renders a field on a device, one image after the other.
pub struct Renderer<'f> {
    field: &'f Field,
    /// The field on a GPU; on the CPU it is rendered where it lies.
    resident: Option<Resident>,
}

impl<'f> Renderer<'f> {
    /// For images of this field.
    pub fn new(device: &Device, field: &'f Field) -> Self {
        Self {
            field,
            resident: device.open_gpu().map(|gpu| Resident::new(gpu, field)),
        }
    }

    /// Renders what a camera sees; see [`crate::render`].
    pub fn render(&self, camera: &Camera, options: &RenderOptions) -> Rendered {
        let Ok(rendered) = self.try_render::<Infallible>(camera, options, &|| Ok(()));
        rendered
    }

    /// Renders what a camera sees, unless `may_go_on`, which is called now and then, returns an
    /// error, which is passed on.
    pub fn try_render<E: Send>(
        &self,
        camera: &Camera,
        options: &RenderOptions,
        may_go_on: &(impl Fn() -> Result<(), E> + Sync),
    ) -> Result<Rendered, E> {
        let Some(resident) = &self.resident else {
            return crate::render::try_render(self.field, camera, options, may_go_on);
        };
        let all = camera.width as usize * camera.height as usize;
        let round = (ROUND / options.rays_per_pixel()).max(1);
        let mut pixels: Vec<RenderedPixel> = Vec::with_capacity(all);
        let mut samples: usize = 0;
        for first in (0..all).step_by(round) {
            may_go_on()?;
            let segments = segments(self.field, camera, options, first..all.min(first + round));
            let (outputs, count) = trace(resident, &segments);
            pixels.extend(averages(&outputs, &segments, camera, options));
            samples += count;
        }
        Ok(image(camera, pixels.iter(), samples))
    }
}

/// The outputs of rays, and how many samples passed through both networks.
fn trace(resident: &Resident, segments: &[Segment]) -> (Vec<RayOutput>, usize) {
    let numbers: Vec<[f32; RAY]> = segments
        .par_iter()
        // Without jitter, so that an image is the same each time.
        .map(|segment| ray(segment, 0.0, 0, 0))
        .collect();
    let gpu = &resident.gpu;
    let rays = Rays::new(&resident.gpu, numbers.as_flattened());
    let at_once = resident.rays_at_once();
    for first in (0..rays.count).step_by(at_once) {
        resident.trace(&rays, first..rays.count.min(first + at_once));
    }
    let outputs = gpu.read(&rays.outputs, 8 * rays.count);
    let counts = gpu.read(&rays.seen, rays.count);
    let outputs = outputs.as_chunks().0.iter().map(ray_output).collect();
    (
        outputs,
        counts.iter().map(|count| count.to_bits() as usize).sum(),
    )
}

fn ray_output(&[r, g, b, transmittance, distance, ..]: &[f32; 8]) -> RayOutput {
    RayOutput {
        rgb: [r, g, b],
        transmittance,
        distance,
    }
}
