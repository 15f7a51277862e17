//! Takes a photo of the world by tracing its rays. Knows nothing of what stands in it.

use glam::Vec3;
use rayon::prelude::*;

use super::light::Lights;
use super::world::{Line, World};
use crate::Camera;
use crate::color::linear_to_srgb;

/// What meets a ray that leaves the world: mid grey, linear. The still life's own cameras have no such ray.
const NOTHING: Vec3 = Vec3::splat(0.18);

/// A rendered image and how far it saw.
pub(super) struct Picture {
    /// `height * width * 3`, sRGB-encoded in 0..=1.
    pub(super) rgb: Vec<f32>,
    pub(super) seen: Seen,
}

/// The extent of all surface points that were seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    /// Least and greatest depth along the view axis.
    pub(super) depth: [f32; 2],
    pub(super) low: Vec3,
    pub(super) high: Vec3,
}

impl Seen {
    /// Nothing seen yet: the neutral element of [`Seen::and`].
    pub(super) const NOTHING: Seen =
        Seen { depth: [f32::INFINITY, f32::NEG_INFINITY], low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    pub(super) fn and(self, other: Seen) -> Seen {
        Seen {
            depth: [self.depth[0].min(other.depth[0]), self.depth[1].max(other.depth[1])],
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }
}

/// Renders with `samples` x `samples` rays through every pixel, on a regular grid, averaged in linear light and only then
/// clipped and encoded: the image is the mean over each pixel's area, known as well as the grid is fine.
pub(super) fn render(world: &World, lights: &Lights, camera: &Camera, samples: u32) -> Picture {
    let rows: Vec<_> = (0..camera.height).into_par_iter().map(|y| row(world, lights, camera, samples, y)).collect();
    let seen = rows.iter().map(|(_, seen)| *seen).fold(Seen::NOTHING, Seen::and);
    Picture { rgb: rows.into_iter().flat_map(|(rgb, _)| rgb).collect(), seen }
}

fn row(world: &World, lights: &Lights, camera: &Camera, samples: u32, y: u32) -> (Vec<f32>, Seen) {
    let mut seen = Seen::NOTHING;
    let mut rgb = Vec::with_capacity(3 * camera.width as usize);
    for x in 0..camera.width {
        let linear = pixel(world, lights, camera, samples, (x, y), &mut seen);
        rgb.extend(linear.to_array().map(|value| linear_to_srgb(value.clamp(0.0, 1.0))));
    }
    (rgb, seen)
}

fn pixel(world: &World, lights: &Lights, camera: &Camera, samples: u32, at: (u32, u32), seen: &mut Seen) -> Vec3 {
    let step = 1.0 / f64::from(samples);
    let mut sum = Vec3::ZERO;
    for sample in 0..samples * samples {
        let (i, j) = (sample % samples, sample / samples);
        let px = f64::from(at.0) + (f64::from(i) + 0.5) * step;
        let py = f64::from(at.1) + (f64::from(j) + 0.5) * step;
        sum += radiance(world, lights, camera, (px, py), sample as usize, seen);
    }
    sum / (samples * samples) as f32
}

fn radiance(world: &World, lights: &Lights, camera: &Camera, at: (f64, f64), sample: usize, seen: &mut Seen) -> Vec3 {
    let ray = camera.ray(at.0, at.1);
    let along = Vec3::from(ray.direction);
    let Some(hit) = world.first_hit(&Line::new(ray.origin.into(), along)) else { return NOTHING };
    let depth = hit.distance / ray.distance_per_depth;
    *seen = seen.and(Seen { depth: [depth; 2], low: hit.point, high: hit.point });
    lights.shade(world, &hit, -along, sample)
}
