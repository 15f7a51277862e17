//! Which samples of a block of rays are seen: densities from front to back, until little of what lies behind would show.
//! Knows nothing of colours or gradients.

use crate::composite;
use crate::field::{Field, sigma};
use crate::network::{Activations, GEOMETRY};
use crate::positions::Positions;
use std::ops::Range;

/// Samples of every ray that are looked at together: enough to fill the kernels, few enough not to go far behind a surface.
const WAVE: usize = 16;
/// The row of a sample that was not kept.
const NONE: u32 = u32::MAX;

/// Samples that are seen, in order, and scratch space to find them, to be used again and again.
#[derive(Default)]
pub struct Look {
    /// Indices of the samples that are seen among all, ascending.
    pub kept: Vec<u32>,
    /// Their densities.
    pub sigma: Vec<f32>,
    /// How many samples were looked at.
    pub looked: usize,
    wave: Wave,
    found: Activations,
    /// By sample: its row in `found`.
    row: Vec<u32>,
    rows: Vec<u32>,
}

/// Samples that are looked at together.
#[derive(Default)]
struct Wave {
    samples: Vec<u32>,
    positions: Positions,
    activations: Activations,
    kept: Vec<u32>,
}

/// A ray whose end is not found yet.
struct Open {
    rest: Range<usize>,
    optical_depth: f32,
}

impl Look {
    /// Looks along `rays` (ranges of samples with these `positions` and step lengths `dt`); leaves the density network's
    /// activations of the samples that are seen, padded.
    pub fn along(
        &mut self,
        field: &Field,
        rays: &[Range<usize>],
        positions: &Positions,
        dt: &[f32],
        activations: &mut Activations,
    ) {
        self.row.clear();
        self.row.resize(dt.len(), NONE);
        self.found.clear();
        self.looked = 0;
        let mut open: Vec<_> = rays.iter().map(|ray| Open { rest: ray.clone(), optical_depth: 0.0 }).collect();
        while !open.is_empty() {
            self.wave.look(field, &open, positions);
            self.looked += self.wave.samples.len();
            self.keep(&mut open, dt);
            self.found.append(&self.wave.activations, &self.wave.kept, field.encoding_width());
        }
        self.kept.clear();
        self.kept.extend((0..dt.len() as u32).filter(|&sample| self.row[sample as usize] != NONE));
        self.rows.clear();
        self.rows.extend(self.kept.iter().map(|&sample| self.row[sample as usize]));
        activations.clear();
        activations.append(&self.found, &self.rows, field.encoding_width());
        activations.pad(field.encoding_width());
        self.sigma.clear();
        self.sigma.extend(activations.geometry.chunks_exact(GEOMETRY).take(self.kept.len()).map(|row| sigma(row[0])));
    }

    /// Notes which samples of a wave are seen, and closes the rays that end.
    fn keep(&mut self, open: &mut Vec<Open>, dt: &[f32]) {
        let Wave { samples, activations, kept, .. } = &mut self.wave;
        kept.clear();
        let first = (self.found.geometry.len() / GEOMETRY) as u32;
        let mut row = 0;
        open.retain_mut(|ray| {
            let length = ray.rest.len().min(WAVE);
            let depth = |row: usize| sigma(activations.geometry[row * GEOMETRY]) * dt[samples[row] as usize];
            let seen = composite::visible((row..row + length).map(depth), &mut ray.optical_depth);
            for (row, &sample) in (row..).zip(&samples[row..row + seen]) {
                self.row[sample as usize] = first + kept.len() as u32;
                kept.push(row as u32);
            }
            row += length;
            ray.rest.start += length;
            seen == length && !ray.rest.is_empty()
        });
    }
}

impl Wave {
    /// Densities of the next samples of every open ray.
    fn look(&mut self, field: &Field, open: &[Open], positions: &Positions) {
        self.samples.clear();
        self.samples.extend(open.iter().flat_map(|ray| ray.rest.clone().take(WAVE)).map(|sample| sample as u32));
        self.positions.clear();
        self.positions.gather(positions, &self.samples);
        self.positions.pad();
        field.density(&self.positions, &mut self.activations);
    }
}
