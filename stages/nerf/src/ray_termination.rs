//! Early ray termination: which samples of some rays are visible. Densities are looked up from front
//! to back, until little of what lies behind would show. Knows nothing of colours or gradients.

use crate::composite;
use crate::exponential::exp;
use crate::features::{Features, LookUp};
use crate::field::{Field, sigma};
use crate::network::{Activations, GEOMETRY};
use crate::positions::Positions;
use crate::samples::Samples;
use std::ops::Range;

/// Samples of every ray whose densities are looked up together: enough to fill the kernels, few enough not to
/// go far behind a surface.
const WAVE: usize = 16;
/// In an image, samples of less compositing weight than this are left out. Haze before a surface is most of
/// what rays pass through, and all of it together shows less than half a step of an 8-bit value.
pub const MIN_WEIGHT: f32 = 1e-4;
/// The row of a sample that is not visible.
const NONE: u32 = u32::MAX;

/// The search for the last visible sample of some rays, wave by wave: [`RayTermination::request`] says
/// which features it needs next, and [`RayTermination::advance`] goes on once they are there.
#[derive(Default)]
pub struct RayTermination {
    /// By sample: its row among the features, [`NONE`] where it is not visible. After
    /// [`RayTermination::keep_visible`] visible samples alone have one.
    pub rows: Vec<u32>,
    /// Samples whose density was computed so far.
    pub queried: usize,
    /// [feature row][[`GEOMETRY`]]: outputs of the density network. Kept by [`RayTermination::run`] alone.
    pub geometry: Vec<f32>,
    /// The least compositing weight of a visible sample.
    least: f32,
    open: Vec<Open>,
    /// The next samples of the open rays and where they are; once asked for, the place of the first
    /// among the features.
    wave: Vec<u32>,
    positions: Positions,
    first: usize,
    /// Optical depths of the wave.
    depths: Vec<f32>,
}

/// A ray whose last visible sample is not found yet.
struct Open {
    rest: Range<usize>,
    optical_depth: f32,
}

impl RayTermination {
    /// Begins with the rays of `samples`.
    pub fn start(&mut self, samples: &Samples) {
        self.open.clear();
        self.open.extend(samples.rays.iter().map(|ray| Open {
            rest: ray.clone(),
            optical_depth: 0.0,
        }));
        self.rows.clear();
        self.rows.resize(samples.t.len(), NONE);
        self.queried = 0;
        // Training leaves nothing faint out; `run` sets a bound of its own.
        self.least = 0.0;
        self.next_wave(samples);
    }

    fn next_wave(&mut self, samples: &Samples) {
        self.wave.clear();
        self.wave.extend(
            self.open
                .iter()
                .flat_map(|ray| ray.rest.clone().take(WAVE))
                .map(|sample| sample as u32),
        );
        self.positions.clear();
        // Made ahead, in the threads of the parts: `request` runs in one thread and only copies.
        self.positions.gather(&samples.positions, &self.wave);
        self.positions.pad();
    }

    /// Adds the positions of the next samples of every open ray to `features`; whether there are
    /// any.
    pub fn request(&mut self, features: &mut Features) -> bool {
        self.first = features.positions.len();
        features
            .positions
            .extend(&self.positions, 0..self.positions.len());
        self.queried += self.wave.len();
        !self.wave.is_empty()
    }

    /// Notes which samples of the wave are visible, closes the rays that end, and goes on to the next
    /// wave.
    pub fn advance(
        &mut self,
        field: &Field,
        samples: &Samples,
        features: &Features,
        scratch: &mut Activations,
    ) {
        self.depths.clear();
        field.sigmas(
            features,
            self.first..self.first + self.wave.len(),
            scratch,
            &mut self.depths,
        );
        self.close(samples);
    }

    /// [`RayTermination::advance`] that also keeps the density network's outputs, which rendering
    /// would otherwise compute again.
    fn advance_and_keep(
        &mut self,
        field: &Field,
        samples: &Samples,
        features: &Features,
        scratch: &mut Activations,
    ) {
        let Self {
            depths, geometry, ..
        } = self;
        depths.clear();
        // The places of padding between waves have rows too.
        geometry.resize(self.first * GEOMETRY, 0.0);
        let wave = self.first..self.first + self.wave.len();
        field.geometry(features, wave, scratch, |rows| {
            depths.extend(rows.chunks_exact(GEOMETRY).map(|row| sigma(row[0])));
            geometry.extend_from_slice(rows);
        });
        self.close(samples);
    }

    /// From the densities of the wave, in `depths`, to the rays that are still open.
    fn close(&mut self, samples: &Samples) {
        // Optical depth: density times length.
        for (depth, &sample) in self.depths.iter_mut().zip(&self.wave) {
            *depth *= samples.dt[sample as usize];
        }
        let mut row = 0;
        self.open.retain_mut(|ray| {
            let length = ray.rest.len().min(WAVE);
            let depths = self.depths[row..row + length].iter().copied();
            let mut transmittance = exp(-ray.optical_depth);
            let seen = composite::visible(depths.clone(), &mut ray.optical_depth);
            let wave = (self.first + row..).zip(ray.rest.start..ray.rest.start + seen);
            for ((row, sample), depth) in wave.zip(depths) {
                let next = transmittance * exp(-depth);
                // What is not a number is not faint: it is to be visible.
                let faint = transmittance - next < self.least;
                if !faint {
                    self.rows[sample] = row as u32;
                }
                transmittance = next;
            }
            row += length;
            ray.rest.start += length;
            // A ray goes on only if all of its wave was visible and some of it is left.
            seen == length && !ray.rest.is_empty()
        });
        self.next_wave(samples);
    }

    /// Drops the samples that are not visible.
    pub fn keep_visible(&mut self, samples: &mut Samples) {
        let kept: Vec<u32> = (0..self.rows.len() as u32)
            .filter(|&sample| self.rows[sample as usize] != NONE)
            .collect();
        self.rows.retain(|&row| row != NONE);
        samples.keep(&kept);
    }

    /// The whole search on one thread, for samples of at least the weight `least`.
    pub fn run(
        &mut self,
        field: &Field,
        samples: &mut Samples,
        features: &mut Features,
        scratch: &mut Activations,
        least: f32,
    ) {
        features.clear(field);
        self.geometry.clear();
        self.start(samples);
        self.least = least;
        while self.request(features) {
            features.look_ups(field).for_each(LookUp::run);
            self.advance_and_keep(field, samples, features, scratch);
        }
        self.keep_visible(samples);
    }
}
