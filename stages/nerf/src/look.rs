//! Which samples of some rays are seen: densities from front to back, until little of what lies
//! behind would show. Knows nothing of colours or gradients.

use crate::composite;
use crate::exponential::exp;
use crate::features::{Features, LookUp};
use crate::field::{Field, sigma};
use crate::network::{Activations, GEOMETRY};
use crate::positions::Positions;
use crate::samples::Samples;
use std::ops::Range;

/// Samples of every ray that are looked at together: enough to fill the kernels, few enough not to
/// go far behind a surface.
const WAVE: usize = 16;
/// In an image, samples of less weight than this are left out. Haze before a surface is most of
/// what rays pass through, and all of it together shows less than half a step of an 8-bit value.
pub const FAINT: f32 = 1e-4;
/// The row of a sample that is not seen.
const NONE: u32 = u32::MAX;

/// The search for the ends of some rays, wave by wave: [`Look::ask`] says which features it needs
/// next, and [`Look::answer`] goes on once they are there.
#[derive(Default)]
pub struct Look {
    /// By sample that is seen: its place among the features.
    pub rows: Vec<u32>,
    /// How many samples were looked at.
    pub looked: usize,
    /// By place among the features: what the density network gives there, rows of [`GEOMETRY`]
    /// numbers. Kept by [`Look::along`] alone.
    pub geometry: Vec<f32>,
    /// The least weight of a sample that is seen.
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

/// A ray whose end is not found yet.
struct Open {
    rest: Range<usize>,
    optical_depth: f32,
}

impl Look {
    /// Begins with the rays of `samples`.
    pub fn start(&mut self, samples: &Samples) {
        self.open.clear();
        self.open.extend(samples.rays.iter().map(|ray| Open {
            rest: ray.clone(),
            optical_depth: 0.0,
        }));
        self.rows.clear();
        self.rows.resize(samples.t.len(), NONE);
        self.looked = 0;
        // Training leaves nothing faint out; `along` sets a bound of its own.
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
        // Made ahead, in the threads of the parts: `ask` runs in one thread and only copies.
        self.positions.gather(&samples.positions, &self.wave);
        self.positions.pad();
    }

    /// Adds the positions of the next samples of every open ray to `features`; whether there are
    /// any.
    pub fn ask(&mut self, features: &mut Features) -> bool {
        self.first = features.positions.len();
        features
            .positions
            .extend(&self.positions, 0..self.positions.len());
        self.looked += self.wave.len();
        !self.wave.is_empty()
    }

    /// Notes which samples of the wave are seen, closes the rays that end, and goes on to the next
    /// wave.
    pub fn answer(
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

    /// The same, which keeps what the density network gives.
    fn answer_and_keep(
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
                // What is not a number is not faint: it is to be seen.
                let faint = transmittance - next < self.least;
                if !faint {
                    self.rows[sample] = row as u32;
                }
                transmittance = next;
            }
            row += length;
            ray.rest.start += length;
            // A ray goes on only if all of its wave was seen and some of it is left.
            seen == length && !ray.rest.is_empty()
        });
        self.next_wave(samples);
    }

    /// Drops the samples that are not seen.
    pub fn cut(&mut self, samples: &mut Samples) {
        let kept: Vec<u32> = (0..self.rows.len() as u32)
            .filter(|&sample| self.rows[sample as usize] != NONE)
            .collect();
        self.rows.retain(|&row| row != NONE);
        samples.keep(&kept);
    }

    /// The whole search on one thread, for samples of at least this weight.
    pub fn along(
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
        while self.ask(features) {
            features.look_ups(field).for_each(LookUp::run);
            self.answer_and_keep(field, samples, features, scratch);
        }
        self.cut(samples);
    }
}
