//! Volume rendering of a bundle of rays and its backward pass: from the hash features of their
//! samples through the networks to each ray's colour, transmittance and distance. Knows nothing of
//! pixels, losses or optimisers.
//!
//! The arrays of a bundle fit into the second-level cache; one thread takes a bundle from the
//! features to the gradients.

use crate::composite;
use crate::config::FEATURES;
use crate::exponential::sigmoid;
use crate::features::Features;
use crate::field::{Field, sigma, sigma_backward};
use crate::kernels::matrix::ROWS;
use crate::march::Segment;
use crate::network::{Activations, COLOR_OUTPUT, GEOMETRY, Transposed};
use crate::positions::Positions;
use crate::samples::Samples;
use crate::spherical::harmonics_backward;
use std::ops::Range;

/// What volume rendering gives for one ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayOutput {
    /// Colour without background: sum of w c.
    pub rgb: [f32; 3],
    /// What is left of the background: T_end.
    pub transmittance: f32,
    /// Sum of w t, in unit-space distance.
    pub distance: f32,
}

/// Gradients of a loss to a [`RayOutput`].
#[derive(Clone, Copy, Debug, Default)]
pub struct RayOutputGradient {
    /// To the colour without background.
    pub rgb: [f32; 3],
    /// To the transmittance of the whole ray.
    pub transmittance: f32,
}

/// Regularisers that need single samples; the strengths are for one ray.
#[derive(Clone, Copy, Debug, Default)]
pub struct Regularizer {
    /// Weight of the distortion loss, in fractions of the ray's range.
    pub distortion: f32,
    /// Downward pull on raw densities in the first part of a ray's range, as instant-ngp's
    /// near-camera regulariser.
    pub fog: f32,
    /// That part, from 0 to 1.
    pub fog_range: f32,
}

/// What backward passes leave: the gradient to the networks' weights, and for the hash table
/// positions with one gradient pair per level each.
#[derive(Default)]
pub struct FieldGradient {
    /// Summed, in the layout of the networks' weights.
    pub weights: Vec<f32>,
    /// Sample positions in unit space.
    pub positions: Positions,
    /// `[level][position]`: gradients to the looked-up features.
    pub levels: Vec<Vec<[f32; FEATURES]>>,
    /// The gradient to the direction of every ray, where it is asked for.
    pub directions: Option<Vec<[f32; 3]>>,
}

impl FieldGradient {
    /// Forgets everything, and makes room for a field.
    pub fn clear(&mut self, field: &Field) {
        self.weights.clear();
        self.weights.resize(field.network.weights.len(), 0.0);
        self.positions.clear();
        self.levels.resize(field.levels.len(), vec![]);
        self.levels.iter_mut().for_each(Vec::clear);
        self.directions.iter_mut().for_each(Vec::clear);
    }

    /// Fills the last group of positions with some that get nothing.
    pub fn pad(&mut self) {
        self.positions.pad();
        self.levels
            .iter_mut()
            .for_each(|level| level.resize(self.positions.len(), [0.0; FEATURES]));
    }
}

/// Rays that are rendered together.
#[derive(Clone)]
pub struct RayBundle<'a> {
    /// These and others, with their samples.
    pub samples: &'a Samples,
    /// Which of them are the bundle's; at least one.
    pub range: Range<usize>,
    /// Hash features of all samples and of some that turned out not to be visible.
    pub features: &'a Features,
    /// By sample: its row among the features.
    pub rows: &'a [u32],
}

impl RayBundle<'_> {
    /// The samples of all rays.
    fn span(&self) -> Range<usize> {
        let rays = &self.samples.rays[self.range.clone()];
        rays[0].start..rays[rays.len() - 1].end
    }

    /// Every ray with the places of its samples among the bundle's.
    fn each(&self) -> impl Iterator<Item = (&Segment, Range<usize>)> {
        let rays = &self.samples.rays[self.range.clone()];
        let first = rays[0].start;
        self.samples.segments[self.range.clone()].iter().zip(
            rays.iter()
                .map(move |ray| ray.start - first..ray.end - first),
        )
    }
}

/// What a forward pass leaves for the backward pass, and scratch space. Used again for the next
/// bundle, so that nothing is allocated anew.
#[derive(Default)]
pub struct VolumeRenderer {
    /// Free for others between a backward pass and the next forward pass.
    pub activations: Activations,
    sigma: Vec<f32>,
    colors: Vec<[f32; 3]>,
    weights: Vec<f32>,
    outputs: Vec<RayOutput>,
    d_weights: Vec<f32>,
    d_sigma: Vec<f32>,
}

impl VolumeRenderer {
    /// Renders a bundle. The outputs are in the order of its rays.
    pub fn forward(&mut self, field: &Field, rays: &RayBundle<'_>) -> &[RayOutput] {
        let span = rays.span();
        let rows = rays.rows[span.clone()].iter().map(|&row| row as usize);
        rays.features
            .rows(rows, field.encoding_width(), &mut self.activations.encoding);
        field.network.density(&mut self.activations);
        self.shade(field, rays)
    }

    /// Renders a bundle whose densities are known: `geometry` has a row of [`GEOMETRY`] outputs of the
    /// density network for each row of features.
    pub fn forward_from(
        &mut self,
        field: &Field,
        rays: &RayBundle<'_>,
        geometry: &[f32],
    ) -> &[RayOutput] {
        let span = rays.span();
        let into = &mut self.activations.geometry;
        into.clear();
        for &row in &rays.rows[span.clone()] {
            into.extend_from_slice(&geometry[row as usize * GEOMETRY..][..GEOMETRY]);
        }
        // Zeros until the last tile of rows is whole.
        into.resize(span.len().next_multiple_of(ROWS) * GEOMETRY, 0.0);
        self.shade(field, rays)
    }

    /// From the density network's outputs to those of the rays.
    fn shade(&mut self, field: &Field, rays: &RayBundle<'_>) -> &[RayOutput] {
        let span = rays.span();
        self.sigma.clear();
        self.sigma.extend(
            self.activations
                .geometry
                .chunks_exact(GEOMETRY)
                .take(span.len())
                .map(|row| sigma(row[0])),
        );
        self.color(field, rays);
        self.composite(rays);
        &self.outputs
    }

    fn color(&mut self, field: &Field, rays: &RayBundle<'_>) {
        self.activations
            .set_directions(rays.each().map(|(segment, ray)| (segment.view, ray)));
        field.network.color(&mut self.activations);
        let rows = self
            .activations
            .color
            .chunks_exact(COLOR_OUTPUT)
            .take(self.sigma.len());
        self.colors.clear();
        self.colors
            .extend(rows.map(|row| [sigmoid(row[0]), sigmoid(row[1]), sigmoid(row[2])]));
    }

    fn composite(&mut self, rays: &RayBundle<'_>) {
        let t = &rays.samples.t[rays.span()];
        let dt = &rays.samples.dt[rays.span()];
        self.weights.resize(t.len(), 0.0);
        self.outputs.clear();
        for (_, ray) in rays.each() {
            let weights = &mut self.weights[ray.clone()];
            let transmittance =
                composite::weights(&self.sigma[ray.clone()], &dt[ray.clone()], weights);
            let mut output = RayOutput {
                transmittance,
                ..RayOutput::default()
            };
            for ((weight, t), color) in weights.iter().zip(&t[ray.clone()]).zip(&self.colors[ray]) {
                output.distance += weight * t;
                output
                    .rgb
                    .iter_mut()
                    .zip(color)
                    .for_each(|(sum, color)| *sum += weight * color);
            }
            self.outputs.push(output);
        }
    }

    /// The backward pass of the last [`VolumeRenderer::forward`]: adds to the gradient of the networks'
    /// weights, appends the one to the hash features, and returns the distortion loss (unweighted,
    /// summed over rays).
    pub fn backward(
        &mut self,
        field: &Field,
        transposed: &Transposed,
        rays: &RayBundle<'_>,
        d_outputs: &[RayOutputGradient],
        regularizer: Regularizer,
        gradient: &mut FieldGradient,
    ) -> f32 {
        self.d_weights.clear();
        self.d_weights.resize(self.sigma.len(), 0.0);
        // Not cleared: the backward pass of the weights writes all of it.
        self.d_sigma.resize(self.sigma.len(), 0.0);
        // Rows of padding must not bring the gradients of the bundle before.
        self.activations.color.fill(0.0);
        let mut distortion = 0.0;
        for (r, ((segment, ray), d)) in rays.each().zip(d_outputs).enumerate() {
            distortion += self.ray_backward(rays, r, segment, ray, d, regularizer);
        }
        field
            .network
            .color_backward(transposed, &mut self.activations, &mut gradient.weights);
        // Before the density's backward pass overwrites what it reads.
        self.append_directions(field, rays, gradient);
        let rows = self.activations.geometry.chunks_exact_mut(GEOMETRY);
        // The raw density is the first of the geometry outputs, which the colour network sees as
        // well.
        rows.zip(&self.d_sigma)
            .for_each(|(row, d_sigma)| row[0] += d_sigma);
        field
            .network
            .density_backward(transposed, &mut self.activations, &mut gradient.weights);
        self.append(rays, field.encoding_width(), gradient);
        distortion
    }

    /// Gradients of one ray: to raw colours, and to raw densities in `d_sigma`. Returns the ray's
    /// distortion loss.
    fn ray_backward(
        &mut self,
        rays: &RayBundle<'_>,
        r: usize,
        segment: &Segment,
        ray: Range<usize>,
        d: &RayOutputGradient,
        regularizer: Regularizer,
    ) -> f32 {
        let weights = &self.weights[ray.clone()];
        let d_weights = &mut self.d_weights[ray.clone()];
        let raw = self.activations.color[ray.start * COLOR_OUTPUT..].chunks_exact_mut(COLOR_OUTPUT);
        for (((raw, color), weight), d_weight) in raw
            .zip(&self.colors[ray.clone()])
            .zip(weights)
            .zip(d_weights.iter_mut())
        {
            for ((raw, color), d_rgb) in raw.iter_mut().zip(color).zip(d.rgb) {
                // C = sum of w c: dL/dw = dL/dC c, and dL/dc = dL/dC w.
                *d_weight += d_rgb * color;
                // d rgb / d raw = w c (1 - c): the sigmoid's derivative from its own output.
                *raw = d_rgb * weight * color * (1.0 - color);
            }
        }
        let samples = rays.samples.rays[rays.range.start + r].clone();
        let t = &rays.samples.t[samples.clone()];
        let dt = &rays.samples.dt[samples];
        let mut distortion = 0.0;
        if regularizer.distortion > 0.0 {
            // In fractions of the ray's range, so that the loss means the same for all scenes.
            let s: Vec<f32> = t.iter().map(|&t| segment.fraction(t)).collect();
            let ds: Vec<f32> = dt
                .iter()
                .map(|dt| dt / (segment.range[1] - segment.range[0]))
                .collect();
            distortion = composite::distortion(&s, &ds, weights, regularizer.distortion, d_weights);
        }
        let d_sigma = &mut self.d_sigma[ray.clone()];
        composite::weights_backward(
            dt,
            weights,
            self.outputs[r].transmittance,
            d_weights,
            d.transmittance,
            d_sigma,
        );
        for (((d_sigma, sigma), t), i) in d_sigma
            .iter_mut()
            .zip(&self.sigma[ray.clone()])
            .zip(t)
            .zip(ray)
        {
            // From density to the network's raw output.
            *d_sigma *= sigma_backward(*sigma);
            // A constant pull on the raw density, before the exponential: it acts where density is
            // nearly 0, too, and ends at exp(-10), where nothing can be seen.
            if segment.fraction(*t) < regularizer.fog_range
                && self.activations.geometry[i * GEOMETRY] > -10.0
            {
                *d_sigma += regularizer.fog;
            }
        }
        distortion
    }

    /// Appends the gradients to the rays' directions, of which only colours know.
    fn append_directions(&self, field: &Field, rays: &RayBundle<'_>, to: &mut FieldGradient) {
        let Some(directions) = &mut to.directions else {
            return;
        };
        let d_harmonics = field.network.harmonics_backward(&self.activations);
        let rays = rays.each().zip(d_harmonics);
        directions.extend(rays.map(|((segment, _), d)| harmonics_backward(segment.view, &d)));
    }

    fn append(&self, rays: &RayBundle<'_>, width: usize, to: &mut FieldGradient) {
        to.positions.extend(&rays.samples.positions, rays.span());
        for (l, level) in to.levels.iter_mut().enumerate() {
            let rows = self
                .activations
                .encoding
                .chunks_exact(width)
                .take(self.sigma.len());
            level.extend(rows.map(|row| [row[FEATURES * l], row[FEATURES * l + 1]]));
        }
    }
}

#[cfg(test)]
mod tests;
