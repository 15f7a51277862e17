//! What a batch of pixels adds to a training step: rays traced, compared with the photos, and gradients all the way back.
//! Knows nothing of optimisers.

use crate::batch::{Pixel, Sampler, TrainView};
use crate::block::{Block, FieldGradient, Regularizer, Seen, SeenGradient};
use crate::field::Field;
use crate::loss::{smooth_l1, smooth_l1_backward};
use crate::march::Segment;
use crate::network::Transposed;
use crate::options::TrainOptions;
use std::ops::Range;

/// What one part of a batch adds to a step.
#[derive(Default)]
pub struct Contribution {
    /// The gradients to the field.
    pub gradient: FieldGradient,
    /// The photometric loss, summed.
    pub loss: f64,
    /// The squared error, summed, without the views' weights.
    pub squared_error: f64,
    /// Rays traced.
    pub rays: usize,
    /// Samples that passed through both networks.
    pub samples: usize,
    /// Samples whose density was looked at.
    pub looked: usize,
}

impl Contribution {
    /// Forgets everything, and makes room for a field.
    pub fn clear(&mut self, field: &Field) {
        let mut gradient = std::mem::take(&mut self.gradient);
        gradient.clear(field);
        *self = Self { gradient, ..Self::default() };
    }
}

/// A batch of pixels, and what it is traced through and compared with.
pub struct Batch<'a> {
    /// The field as it is now.
    pub field: &'a Field,
    /// Its networks' weights, turned over.
    pub transposed: &'a Transposed,
    /// The photos.
    pub views: &'a [TrainView],
    /// Draws the pixels.
    pub sampler: &'a Sampler,
    /// How to train.
    pub options: &'a TrainOptions,
    /// Steps taken so far.
    pub step: u32,
    /// Pixels of the whole batch.
    pub pixels: u32,
}

impl Batch<'_> {
    /// Adds what some of the batch's pixels contribute, `per_block` at a time.
    pub fn trace_all(&self, elements: Range<u32>, per_block: u32, block: &mut Block, part: &mut Contribution) {
        for first in elements.clone().step_by(per_block as usize) {
            let elements = first..elements.end.min(first + per_block);
            let pixels: Vec<Pixel> = elements.map(|element| self.pixel(element)).collect();
            self.trace(block, &pixels, part);
        }
    }

    fn pixel(&self, element: u32) -> Pixel {
        let (step, count) = (u64::from(self.step), u64::from(self.pixels));
        let mut pixel = self.sampler.pixel(self.views, step, u64::from(element), count);
        if !self.options.random_background {
            pixel.background = [0.0; 3];
        }
        pixel
    }

    /// Traces the sub-rays of some pixels, compares, and goes all the way back.
    fn trace(&self, block: &mut Block, pixels: &[Pixel], part: &mut Contribution) {
        let (mut segments, mut jitter) = (vec![], vec![]);
        for &pixel in pixels {
            let view = &self.views[pixel.view];
            for (px, py, shift) in self.sampler.sub_rays(pixel, view.supersample, u64::from(self.step)) {
                segments.push(Segment::new(&self.field.space, &view.camera, px, py));
                jitter.push(shift);
            }
        }
        let seen = block.forward(self.field, &segments, &jitter);
        let (d_seen, loss, squared_error) = self.compare(pixels, seen);
        let regularizer = self.regularizer(segments.len() as f32 / pixels.len() as f32);
        block.backward(self.field, self.transposed, &segments, &d_seen, regularizer, &mut part.gradient);
        part.loss += loss;
        part.squared_error += squared_error;
        part.rays += segments.len();
        part.samples += block.samples();
        part.looked += block.looked();
    }

    /// The strengths per ray, so that their sum over a batch does not depend on its size.
    fn regularizer(&self, rays_per_pixel: f32) -> Regularizer {
        let share = 1.0 / (self.pixels as f32 * rays_per_pixel);
        Regularizer {
            distortion: self.options.distortion as f32 * share,
            fog: self.options.fog as f32 * share,
            fog_range: self.options.fog_range as f32,
        }
    }

    /// Gradients to what every sub-ray sees, the summed loss and the summed squared error. A pixel is the mean of its
    /// sub-rays.
    fn compare(&self, pixels: &[Pixel], seen: &[Seen]) -> (Vec<SeenGradient>, f64, f64) {
        let (mut d_seen, mut loss, mut squared_error) = (Vec::with_capacity(seen.len()), 0.0, 0.0);
        let mut rest = seen;
        for pixel in pixels {
            let view = &self.views[pixel.view];
            let (rays, behind) = rest.split_at((view.supersample * view.supersample) as usize);
            rest = behind;
            let (target, share) = (view.target(pixel), 1.0 / rays.len() as f32);
            let mut d = SeenGradient::default();
            for (c, target) in target.into_iter().enumerate() {
                let color = |ray: &Seen| ray.rgb[c] + ray.transmittance * pixel.background[c];
                let residual = share * rays.iter().map(color).sum::<f32>() - target;
                let beta = self.options.beta as f32;
                loss += f64::from(view.weight * smooth_l1(residual, beta));
                squared_error += f64::from(residual * residual);
                d.rgb[c] = view.weight * share * smooth_l1_backward(residual, beta) / (3.0 * self.pixels as f32);
                d.transmittance += d.rgb[c] * pixel.background[c];
            }
            d_seen.extend(std::iter::repeat_n(d, rays.len()));
        }
        (d_seen, loss, squared_error)
    }
}
