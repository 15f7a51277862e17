//! A block of rays through the field: march, encode, networks, compositing, and all the way back. Knows nothing of
//! pixels, losses or optimisers.
//!
//! The arrays of a block fit into the second-level cache; one thread takes a block from the march to the gradients.

use crate::composite;
use crate::config::FEATURES;
use crate::exponential::sigmoid;
use crate::field::{Field, sigma_backward};
use crate::look::Look;
use crate::march::{Segment, march};
use crate::network::{Activations, COLOR_INPUT, COLOR_OUTPUT, GEOMETRY, Transposed};
use crate::positions::Positions;
use crate::spherical::harmonics;
use std::ops::Range;

/// What one ray sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Colour without background: sum of w c.
    pub rgb: [f32; 3],
    /// What is left of the background: T_end.
    pub transmittance: f32,
    /// Sum of w t, in unit-space distance.
    pub distance: f32,
}

/// Gradients of a loss to what one ray sees.
#[derive(Clone, Copy, Debug, Default)]
pub struct SeenGradient {
    /// To the colour without background.
    pub rgb: [f32; 3],
    /// To the transmittance.
    pub transmittance: f32,
}

/// Regularisers that need single samples; the strengths are for one ray.
#[derive(Clone, Copy, Debug, Default)]
pub struct Regularizer {
    /// Weight of the distortion loss, in fractions of the ray's range.
    pub distortion: f32,
    /// Downward pull on raw densities in the first part of a ray's range, as instant-ngp's near-camera regulariser.
    pub fog: f32,
    /// That part, from 0 to 1.
    pub fog_range: f32,
}

/// What backward passes leave: the gradient to the networks' weights, and for the hash table positions with one gradient
/// pair per level each.
#[derive(Default)]
pub struct FieldGradient {
    /// Summed, in the layout of the networks' weights.
    pub weights: Vec<f32>,
    /// Sample positions, padded.
    pub positions: Positions,
    /// `[level][position]`; zero for padding.
    pub levels: Vec<Vec<[f32; FEATURES]>>,
}

impl FieldGradient {
    /// Forgets everything, and makes room for a field.
    pub fn clear(&mut self, field: &Field) {
        self.weights.clear();
        self.weights.resize(field.network.weights.len(), 0.0);
        self.positions.clear();
        self.levels.resize(field.levels.len(), vec![]);
        self.levels.iter_mut().for_each(Vec::clear);
    }
}

/// Scratch space for a block of rays, to be used again and again.
#[derive(Default)]
pub struct Block {
    positions: Positions,
    rays: Vec<Range<usize>>,
    look: Look,
    t: Vec<f32>,
    dt: Vec<f32>,
    weights: Vec<f32>,
    seen: Vec<Seen>,
    activations: Activations,
}

impl Block {
    /// What each ray sees. `jitter` shifts a ray's steps by a part of a step.
    pub fn forward(&mut self, field: &Field, segments: &[Segment], jitter: &[f32]) -> &[Seen] {
        self.march(field, segments, jitter);
        self.look.along(field, &self.rays, &self.positions, &self.dt, &mut self.activations);
        self.cut();
        self.color(field, segments);
        self.composite();
        &self.seen
    }

    /// Samples that passed through both networks in the last forward pass.
    pub fn samples(&self) -> usize {
        self.look.kept.len()
    }

    /// Samples whose density was looked at in the last forward pass.
    pub fn looked(&self) -> usize {
        self.look.looked
    }

    fn march(&mut self, field: &Field, segments: &[Segment], jitter: &[f32]) {
        self.positions.clear();
        self.rays.clear();
        self.t.clear();
        self.dt.clear();
        for (segment, &jitter) in segments.iter().zip(jitter) {
            let first = self.t.len();
            march(&field.occupancy, field.stride(), segment, jitter, |t, dt| {
                // Rounding may put a point just below the box, where the grid has no cells.
                self.positions.push(segment.at(t).map(|x| x.max(0.0)));
                self.t.push(t);
                self.dt.push(dt);
            });
            self.rays.push(first..self.t.len());
        }
    }

    /// Drops the samples that are not seen, and closes the gaps.
    fn cut(&mut self) {
        let kept = &self.look.kept;
        let mut end = 0;
        for ray in &mut self.rays {
            let first = end;
            end += kept[first..].iter().take_while(|&&sample| (sample as usize) < ray.end).count();
            *ray = first..end;
        }
        let [x, y, z] = &mut self.positions.0;
        for values in [x, y, z, &mut self.t, &mut self.dt] {
            kept.iter().enumerate().for_each(|(to, &from)| values[to] = values[from as usize]);
            values.truncate(kept.len());
        }
        self.positions.pad();
    }

    fn color(&mut self, field: &Field, segments: &[Segment]) {
        let Activations { geometry, color_input, .. } = &mut self.activations;
        color_input.clear();
        color_input.resize(self.positions.len() * COLOR_INPUT, 0.0);
        for (ray, segment) in self.rays.iter().zip(segments) {
            let direction = harmonics(segment.direction);
            for i in ray.clone() {
                let row = &mut color_input[i * COLOR_INPUT..(i + 1) * COLOR_INPUT];
                row[..GEOMETRY].copy_from_slice(&geometry[i * GEOMETRY..(i + 1) * GEOMETRY]);
                row[GEOMETRY..].copy_from_slice(&direction);
            }
        }
        field.network.color(&mut self.activations);
    }

    fn composite(&mut self) {
        self.weights.resize(self.t.len(), 0.0);
        self.seen.clear();
        for ray in self.rays.iter().cloned() {
            let weights = &mut self.weights[ray.clone()];
            let transmittance = composite::weights(&self.look.sigma[ray.clone()], &self.dt[ray.clone()], weights);
            let mut seen = Seen { transmittance, ..Seen::default() };
            for i in ray {
                let weight = self.weights[i];
                seen.distance += weight * self.t[i];
                for (sum, raw) in seen.rgb.iter_mut().zip(&self.activations.color[i * COLOR_OUTPUT..]) {
                    *sum += weight * sigmoid(*raw);
                }
            }
            self.seen.push(seen);
        }
    }

    /// The backward pass of the last [`Block::forward`]: adds to the gradient of the networks' weights, appends the one to the
    /// hash features, and returns the distortion loss (unweighted, summed over rays).
    pub fn backward(
        &mut self,
        field: &Field,
        transposed: &Transposed,
        segments: &[Segment],
        d_seen: &[SeenGradient],
        regularizer: Regularizer,
        gradient: &mut FieldGradient,
    ) -> f32 {
        let mut d_raw = vec![0.0; self.t.len()];
        let mut distortion = 0.0;
        for (r, (segment, d)) in segments.iter().zip(d_seen).enumerate() {
            distortion += self.ray_backward(self.rays[r].clone(), self.seen[r], segment, d, regularizer, &mut d_raw);
        }
        self.activations.color[self.t.len() * COLOR_OUTPUT..].fill(0.0);
        field.network.color_backward(transposed, &mut self.activations, &mut gradient.weights);
        let Activations { geometry, color_input, .. } = &mut self.activations;
        geometry.fill(0.0);
        let rows = geometry.chunks_exact_mut(GEOMETRY).zip(color_input.chunks_exact(COLOR_INPUT));
        for ((row, d_input), d_raw) in rows.zip(&d_raw) {
            row.copy_from_slice(&d_input[..GEOMETRY]);
            row[0] += d_raw;
        }
        field.network.density_backward(transposed, &mut self.activations, &mut gradient.weights);
        self.append(field.encoding_width(), gradient);
        distortion
    }

    /// Gradients of one ray: raw colours in place, raw densities in `d_raw`. Returns the ray's distortion loss.
    fn ray_backward(
        &mut self,
        ray: Range<usize>,
        seen: Seen,
        segment: &Segment,
        d: &SeenGradient,
        regularizer: Regularizer,
        d_raw: &mut [f32],
    ) -> f32 {
        let mut d_weight = vec![0.0; ray.len()];
        for (i, d_weight) in ray.clone().zip(&mut d_weight) {
            let raw = &mut self.activations.color[i * COLOR_OUTPUT..(i + 1) * COLOR_OUTPUT];
            for (raw, d_rgb) in raw.iter_mut().zip(d.rgb) {
                let color = sigmoid(*raw);
                *d_weight += d_rgb * color;
                *raw = d_rgb * self.weights[i] * color * (1.0 - color);
            }
            raw[3..].fill(0.0);
        }
        let (weights, dt) = (&self.weights[ray.clone()], &self.dt[ray.clone()]);
        let mut distortion = 0.0;
        if regularizer.distortion > 0.0 {
            let s: Vec<f32> = self.t[ray.clone()].iter().map(|&t| segment.fraction(t)).collect();
            let ds: Vec<f32> = dt.iter().map(|dt| dt / (segment.range[1] - segment.range[0])).collect();
            distortion = composite::distortion(&s, &ds, weights, regularizer.distortion, &mut d_weight);
        }
        let mut d_sigma = vec![0.0; ray.len()];
        composite::weights_backward(dt, weights, seen.transmittance, &d_weight, d.transmittance, &mut d_sigma);
        for (i, d_sigma) in ray.zip(d_sigma) {
            let raw = self.activations.geometry[i * GEOMETRY];
            d_raw[i] = d_sigma * sigma_backward(raw);
            if segment.fraction(self.t[i]) < regularizer.fog_range && raw > -10.0 {
                d_raw[i] += regularizer.fog;
            }
        }
        distortion
    }

    fn append(&self, width: usize, to: &mut FieldGradient) {
        to.positions.extend(&self.positions);
        for (l, level) in to.levels.iter_mut().enumerate() {
            let rows = self.activations.encoding.chunks_exact(width);
            level.extend(rows.map(|row| [row[FEATURES * l], row[FEATURES * l + 1]]));
        }
    }
}

#[cfg(test)]
mod tests;
