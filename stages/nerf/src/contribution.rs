//! What a batch of pixels adds to a training step: rays traced, compared with the photos, and
//! gradients all the way back. Knows nothing of optimisers.

use crate::batch::{Pixel, Sampler, TrainView};
use crate::corrections::{Corrections, ViewGradients, cameras_backward};
use crate::exposure::{self, Exposure};
use crate::features::Features;
use crate::field::Field;
use crate::loss::{smooth_l1, smooth_l1_backward};
use crate::march::Segment;
use crate::network::Transposed;
use crate::options::TrainOptions;
use crate::ray_termination::RayTermination;
use crate::samples::Samples;
use crate::view_parameters::ViewVector;
use crate::volume_rendering::{
    FieldGradient, RayBundle, RayOutput, RayOutputGradient, Regularizer, VolumeRenderer,
};
use std::ops::Range;

/// One part of a batch, and what it adds to a step.
#[derive(Default)]
pub struct Contribution {
    pixels: Vec<Pixel>,
    /// The samples of the pixels' sub-rays.
    pub samples: Samples,
    /// The search for the visible ones.
    pub termination: RayTermination,
    /// The gradients to the field.
    pub gradient: FieldGradient,
    /// The photometric loss, summed.
    pub loss: f64,
    /// The squared error, summed, without the views' weights.
    pub squared_error: f64,
    /// The gradients to the exposures and poses of the views.
    pub view_gradients: ViewGradients,
}

/// A batch of pixels, and what it is traced through and compared with.
pub struct Batch<'a> {
    /// The field as it is now.
    pub field: &'a Field,
    /// Its networks' weights, turned over.
    pub transposed: &'a Transposed,
    /// The photos with their cameras.
    pub views: &'a [TrainView],
    /// Draws pixels by their number in the batch.
    pub sampler: &'a Sampler,
    /// What is learnt about them.
    pub corrections: &'a Corrections,
    /// Strengths of the losses, and how pixels are drawn.
    pub options: &'a TrainOptions,
    /// Steps taken so far.
    pub step: u32,
    /// Pixels of the whole batch.
    pub pixels: u32,
}

impl Batch<'_> {
    /// Begins a part with some of the batch's pixels: marches along their sub-rays.
    pub fn march(&self, elements: Range<u32>, part: &mut Contribution) {
        let Contribution {
            pixels,
            samples,
            termination,
            ..
        } = part;
        pixels.clear();
        // Pixels are drawn by their number in the batch, whichever part they fall to.
        pixels.extend(elements.map(|element| self.pixel(element)));
        samples.clear();
        for &pixel in pixels.iter() {
            let view = &self.views[pixel.view];
            for (px, py, shift) in
                self.sampler
                    .sub_rays(pixel, view.supersample, u64::from(self.step))
            {
                samples.march(
                    self.field,
                    Segment::new(&self.field.space, &view.camera, px, py),
                    shift,
                );
            }
        }
        termination.start(samples);
    }

    /// Ends a part for which everything has been looked up: its rays are rendered, compared with the
    /// photos, and gradients taken back to the field; `per_bundle` pixels at a time.
    pub fn learn(
        &self,
        features: &Features,
        per_bundle: usize,
        renderer: &mut VolumeRenderer,
        part: &mut Contribution,
    ) {
        let Contribution {
            pixels,
            samples,
            termination,
            gradient,
            loss,
            squared_error,
            view_gradients,
        } = part;
        termination.keep_visible(samples);
        let moves = self.corrections.move_cameras(self.step);
        let exposes = self.corrections.exposures.is_some();
        view_gradients.clear(self.views.len(), exposes, moves);
        gradient.directions = moves.then(Vec::new);
        gradient.clear(self.field);
        *loss = 0.0;
        *squared_error = 0.0;
        let mut first = 0;
        for pixels in pixels.chunks(per_bundle) {
            let count = pixels
                .iter()
                .map(|pixel| self.views[pixel.view].rays_per_pixel())
                .sum::<usize>();
            let rays = RayBundle {
                samples,
                range: first..first + count,
                features,
                rows: &termination.rows,
            };
            first += count;
            let (d_outputs, more, squared) =
                self.compare(pixels, renderer.forward(self.field, &rays), view_gradients);
            let regularizer = self.regularizer(count as f32 / pixels.len() as f32);
            renderer.backward(
                self.field,
                self.transposed,
                &rays,
                &d_outputs,
                regularizer,
                gradient,
            );
            *loss += more;
            *squared_error += squared;
        }
        gradient.pad();
        if moves {
            cameras_backward(
                self.field,
                self.views,
                pixels,
                samples,
                gradient,
                &mut view_gradients.poses,
            );
        }
    }

    fn pixel(&self, element: u32) -> Pixel {
        let step = u64::from(self.step);
        let count = u64::from(self.pixels);
        let mut pixel = self
            .sampler
            .pixel(self.views, step, u64::from(element), count);
        if !self.options.random_background {
            pixel.background = [0.0; 3];
        }
        pixel
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

    /// Gradients to the outputs of every sub-ray, the summed loss and the summed squared error; adds to
    /// the gradients to exposures. A pixel is the mean of its sub-rays.
    fn compare(
        &self,
        pixels: &[Pixel],
        outputs: &[RayOutput],
        view_gradients: &mut ViewGradients,
    ) -> (Vec<RayOutputGradient>, f64, f64) {
        let mut d_outputs = Vec::with_capacity(outputs.len());
        let mut loss = 0.0;
        let mut squared_error = 0.0;
        let mut rest = outputs;
        for pixel in pixels {
            let view = &self.views[pixel.view];
            let (rays, behind) = rest.split_at(view.rays_per_pixel());
            rest = behind;
            let target = view.target(pixel);
            let exposure = self.corrections.exposure(pixel.view);
            let Exposure { gain, lift, .. } = exposure.unwrap_or(Exposure::NONE);
            let share = 1.0 / rays.len() as f32;
            let mut d = RayOutputGradient::default();
            let mut d_shown = [0.0; 3];
            for (c, target) in target.into_iter().enumerate() {
                // The background is drawn, not photographed: no exposure changes it.
                let color = |ray: &RayOutput| {
                    let shown = gain[c] * ray.rgb[c] + (1.0 - ray.transmittance) * lift[c];
                    shown + ray.transmittance * pixel.background[c]
                };
                let mut residual = share * rays.iter().map(color).sum::<f32>() - target;
                if exposure.is_some() {
                    residual = exposure::clipped_residual(residual, target);
                }
                let beta = self.options.beta as f32;
                loss += f64::from(view.weight * smooth_l1(residual, beta));
                squared_error += f64::from(residual * residual);
                // The loss is a mean over channels and over the whole batch, of which this part
                // knows the size.
                d_shown[c] = view.weight * share * smooth_l1_backward(residual, beta)
                    / (3.0 * self.pixels as f32);
                d.rgb[c] = gain[c] * d_shown[c];
                // The derivative by T of gain rgb + (1 - T) lift + T background.
                d.transmittance += d_shown[c] * (pixel.background[c] - lift[c]);
            }
            if let Some(exposure) = exposure {
                let pull = exposure_backward(&exposure, rays, d_shown);
                let sums = view_gradients.exposures[pixel.view].iter_mut();
                sums.zip(pull).for_each(|(sum, d)| *sum += d);
            }
            // All rays of a pixel have one gradient, as the pixel is their mean.
            d_outputs.extend(std::iter::repeat_n(d, rays.len()));
        }
        (d_outputs, loss, squared_error)
    }
}

/// The gradient to a view's exposure from those to the colours that a pixel's rays show.
fn exposure_backward(exposure: &Exposure, rays: &[RayOutput], d_shown: [f32; 3]) -> ViewVector {
    let opacity: f32 = rays.iter().map(|ray| 1.0 - ray.transmittance).sum();
    let color = |c: usize| rays.iter().map(|ray| ray.rgb[c]).sum::<f32>();
    let d_gain = [0, 1, 2].map(|c| d_shown[c] * color(c));
    exposure.backward(d_gain, d_shown.map(|d| d * opacity))
}
