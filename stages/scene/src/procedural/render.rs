//! Takes a photo of the world by tracing its rays. Knows nothing of what stands in it.

use formats::color::linear_to_srgb;
use formats::{Camera, Pixels, Srgb};
use glam::Vec3;
use rayon::prelude::*;

use super::light::Lights;
use super::world::{Line, World};

/// A rendered image and how far it saw.
pub(super) struct Picture {
    /// `height * width * 3`, sRGB-encoded in 0..=1.
    pub(super) rgb: Vec<f32>,
    /// The part of each pixel that shows something, `height * width`. `rgb` is the mean of that
    /// part alone.
    pub(super) alpha: Vec<f32>,
    pub(super) seen: Seen,
}

impl Picture {
    /// What a photo of it holds: alpha only where something is transparent.
    pub(super) fn pixels(self) -> Pixels<Srgb> {
        let alpha = Some(self.alpha).filter(|alpha| alpha.iter().any(|part| *part < 1.0));
        Pixels::new(self.rgb, alpha)
    }
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
    pub(super) const NOTHING: Seen = Seen {
        depth: [f32::INFINITY, f32::NEG_INFINITY],
        low: Vec3::INFINITY,
        high: Vec3::NEG_INFINITY,
    };

    pub(super) fn and(self, other: Seen) -> Seen {
        Seen {
            depth: [
                self.depth[0].min(other.depth[0]),
                self.depth[1].max(other.depth[1]),
            ],
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }
}

/// Renders with `samples` x `samples` rays through every pixel, on a regular grid, averaged in
/// linear light and only then clipped and encoded: the image is the mean over each pixel's area,
/// known as well as the grid is fine.
pub(super) fn render(world: &World, lights: &Lights, camera: &Camera, samples: u32) -> Picture {
    // Rows are collected in order and sums stay within a pixel: threads change no bit.
    let rows: Vec<_> = (0..camera.height)
        .into_par_iter()
        .map(|y| row(world, lights, camera, samples, y))
        .collect();
    let seen = rows
        .iter()
        .map(|row| row.seen)
        .fold(Seen::NOTHING, Seen::and);
    let (rgb, alpha) = rows
        .into_iter()
        .map(|row| (row.rgb, row.alpha))
        .unzip::<_, _, Vec<_>, Vec<_>>();
    Picture {
        rgb: rgb.concat(),
        alpha: alpha.concat(),
        seen,
    }
}

fn row(world: &World, lights: &Lights, camera: &Camera, samples: u32, y: u32) -> Picture {
    let mut row = Picture {
        rgb: Vec::new(),
        alpha: Vec::new(),
        seen: Seen::NOTHING,
    };
    for x in 0..camera.width {
        let (linear, part) = pixel(world, lights, camera, samples, (x, y), &mut row.seen);
        row.rgb.extend(
            linear
                .to_array()
                .map(|value| linear_to_srgb(value.clamp(0.0, 1.0))),
        );
        row.alpha.push(part);
    }
    row
}

/// The mean of the pixel's rays that meet something, and their part of all rays.
fn pixel(
    world: &World,
    lights: &Lights,
    camera: &Camera,
    samples: u32,
    at: (u32, u32),
    seen: &mut Seen,
) -> (Vec3, f32) {
    let step = 1.0 / f64::from(samples);
    let mut sum = Vec3::ZERO;
    let mut met = 0u32;
    for sample in 0..samples * samples {
        let i = sample % samples;
        let j = sample / samples;
        let px = f64::from(at.0) + (f64::from(i) + 0.5) * step;
        let py = f64::from(at.1) + (f64::from(j) + 0.5) * step;
        if let Some(light) = radiance(world, lights, camera, (px, py), sample as usize, seen) {
            (sum, met) = (sum + light, met + 1);
        }
    }
    (
        // Of what was met only: the background is alpha's part.
        sum / met.max(1) as f32,
        met as f32 / (samples * samples) as f32,
    )
}

/// What comes along a ray; `None` if it leaves the world.
fn radiance(
    world: &World,
    lights: &Lights,
    camera: &Camera,
    at: (f64, f64),
    sample: usize,
    seen: &mut Seen,
) -> Option<Vec3> {
    let ray = camera.ray(at.0, at.1);
    let along = Vec3::from(ray.direction);
    let hit = world.first_hit(&Line::new(ray.origin.into(), along))?;
    // The tracer counts along the ray, near and far along the view axis.
    let depth = hit.distance / ray.distance_per_depth;
    *seen = seen.and(Seen {
        depth: [depth; 2],
        low: hit.point,
        high: hit.point,
    });
    Some(lights.shade(world, &hit, -along, sample))
}
