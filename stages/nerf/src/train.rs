//! Fits a field to photos: batches, gradients, optimiser, occupancy. Knows nothing of how a ray is traced or a kernel
//! runs.

use crate::adam::{Moments, Rates, SparseMoments, update_dense, update_sparse};
use crate::batch::{Pixel, Sampler, TrainView};
use crate::block::{Block, FieldGradient, Regularizer, Seen, SeenGradient};
use crate::config::FEATURES;
use crate::field::Field;
use crate::kernels::hash::encode_backward;
use crate::loss::{psnr, smooth_l1, smooth_l1_backward};
use crate::march::Segment;
use crate::network::Transposed;
use crate::survey;
use compute::rng::Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Parts of a batch whose gradients are summed in order; fixed, so that sums do not depend on the number of threads.
const PARTS: u32 = 32;
/// Rays that go from the march to the gradients together: their activations stay in the second-level cache.
const RAYS_PER_BLOCK: u32 = 32;
/// Pixels of the first batch, and the fewest of any.
const PIXELS: [u32; 2] = [64, 16];
/// Rays of the largest batch.
const MOST_RAYS: u32 = 1 << 16;
/// Steps between updates of the occupancy grid.
const OCCUPANCY_EVERY: u32 = 16;

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Steps in all; the learning rate's schedule stretches over them.
    pub steps: u32,
    /// Samples along rays per step: the number of pixels in a batch follows from it.
    pub samples: u32,
    /// Adam's learning rate at its highest.
    pub rate: f64,
    /// The learning rate of the last step, as a part of `rate`; it falls exponentially.
    pub final_rate: f64,
    /// Steps over which the learning rate rises to `rate`.
    pub warm_up: u32,
    /// Where the loss turns from squared to absolute; at 1 it is half the squared error.
    pub beta: f64,
    /// Pull of the networks' weights towards zero; hash entries have none.
    pub l2: f64,
    /// Weight of the distortion loss, which draws the weights along a ray together.
    pub distortion: f64,
    /// Downward pull on raw densities near the cameras.
    pub fog: f64,
    /// The part of a ray's range that is near the camera in this sense.
    pub fog_range: f64,
    /// Put a random colour behind every pixel, of the field and of a transparent photo alike: holes in an opaque photo
    /// then cost as much as they let through. Otherwise the background is black.
    pub random_background: bool,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            steps: 2000,
            samples: 1 << 14,
            rate: 1e-2,
            final_rate: 0.1,
            warm_up: 50,
            beta: 1.0,
            l2: 1e-6,
            distortion: 1e-3,
            fog: 1e-4,
            fog_range: 0.05,
            random_background: true,
        }
    }
}

/// What a training step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// The photometric loss: smooth L1, mean over the batch's pixels and channels, with the views' weights.
    pub loss: f64,
    /// PSNR of the batch's pixels in dB, without weights.
    pub psnr: f64,
    /// Rays of the batch.
    pub rays: usize,
    /// Samples that passed through both networks.
    pub samples: usize,
}

/// A field in training.
pub struct Trainer {
    pub(crate) field: Field,
    pub(crate) options: TrainOptions,
    pub(crate) step: u32,
    pub(crate) pixels: u32,
    pub(crate) table_moments: SparseMoments,
    pub(crate) network_moments: Moments,
    views: Vec<TrainView>,
    sampler: Sampler,
    survey_rng: Rng,
    d_table: Vec<[f32; FEATURES]>,
    parts: Vec<Contribution>,
}

/// What one part of a batch adds to a step.
#[derive(Default)]
struct Contribution {
    gradient: FieldGradient,
    loss: f64,
    squared_error: f64,
    rays: usize,
    samples: usize,
    looked: usize,
}

impl Trainer {
    /// Starts or takes up training of a field. Cells that none of the views sees are emptied for good.
    ///
    /// Panics if a view's sizes do not fit together or there is no view.
    pub fn new(mut field: Field, views: Vec<TrainView>, options: &TrainOptions, seed: u64) -> Self {
        assert!(!views.is_empty(), "training needs at least one view");
        views.iter().for_each(TrainView::check);
        survey::see(&mut field, &views.iter().map(|view| &view.camera).collect::<Vec<_>>());
        Self {
            step: 0,
            pixels: PIXELS[0],
            table_moments: SparseMoments::new(&field.table),
            network_moments: Moments::new(field.network.weights.len()),
            sampler: Sampler::new(&views, seed),
            survey_rng: Rng::new(seed, "occupancy update"),
            d_table: vec![[0.0; FEATURES]; field.table.len()],
            parts: (0..PARTS).map(|_| Contribution::default()).collect(),
            options: options.clone(),
            field,
            views,
        }
    }

    /// The field as it is now.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Ends training.
    pub fn into_field(self) -> Field {
        self.field
    }

    /// Steps taken so far.
    pub fn steps_taken(&self) -> u32 {
        self.step
    }

    /// One training step. If the loss is not a finite number, nothing is learnt from it: the field stays as it was.
    pub fn step(&mut self) -> StepStats {
        let mut parts = std::mem::take(&mut self.parts);
        self.contribute(&mut parts);
        let stats = self.stats(&parts);
        if stats.loss.is_finite() {
            self.descend(&parts);
        }
        self.step += 1;
        if self.step.is_multiple_of(OCCUPANCY_EVERY) {
            survey::update(&mut self.field, &self.survey_rng);
        }
        self.pixels = self.next_pixels(stats.samples, parts.iter().map(|part| part.looked).sum());
        self.parts = parts;
        stats
    }

    fn stats(&self, parts: &[Contribution]) -> StepStats {
        let count = f64::from(self.pixels) * 3.0;
        StepStats {
            loss: parts.iter().map(|part| part.loss).sum::<f64>() / count,
            psnr: psnr(parts.iter().map(|part| part.squared_error).sum::<f64>() / count),
            rays: parts.iter().map(|part| part.rays).sum(),
            samples: parts.iter().map(|part| part.samples).sum(),
        }
    }

    /// Rays of a pixel of the view that has the most.
    fn rays_per_pixel(&self) -> u32 {
        self.views.iter().map(|view| view.supersample * view.supersample).max().unwrap_or(1)
    }

    /// Pixels of the next batch, so that it costs what the wanted samples cost; a sample that is only looked at counts a
    /// quarter of one that is trained on. At most twice or half as many as before.
    fn next_pixels(&self, samples: usize, looked: usize) -> u32 {
        let cost = (3 * samples as u64 + looked as u64).max(1);
        let wanted = u64::from(self.pixels) * 4 * u64::from(self.options.samples) / cost;
        let near = wanted.clamp(u64::from(self.pixels / 2), u64::from(self.pixels) * 2) as u32;
        self.within_limits(near.next_multiple_of(PIXELS[1]))
    }

    /// The nearest number of pixels that a batch may have.
    pub(crate) fn within_limits(&self, pixels: u32) -> u32 {
        pixels.clamp(PIXELS[1], MOST_RAYS / self.rays_per_pixel())
    }

    /// Gradients of the batch, part by part.
    fn contribute(&self, parts: &mut [Contribution]) {
        let transposed = self.field.network.transposed();
        let per_block = (RAYS_PER_BLOCK / self.rays_per_pixel()).max(1);
        parts.par_iter_mut().enumerate().for_each_init(Block::default, |block, (part, contribution)| {
            contribution.clear(&self.field);
            let start = |part: u32| (u64::from(part) * u64::from(self.pixels) / u64::from(PARTS)) as u32;
            let (first, end) = (start(part as u32), start(part as u32 + 1));
            for first in (first..end).step_by(per_block as usize) {
                let elements = first..end.min(first + per_block);
                let pixels: Vec<Pixel> = elements.map(|element| self.pixel(element)).collect();
                self.trace(block, &pixels, &transposed, contribution);
            }
        });
    }

    fn pixel(&self, element: u32) -> Pixel {
        let (step, count) = (u64::from(self.step), u64::from(self.pixels));
        let mut pixel = self.sampler.pixel(&self.views, step, u64::from(element), count);
        if !self.options.random_background {
            pixel.background = [0.0; 3];
        }
        pixel
    }

    /// Traces the sub-rays of some pixels, compares, and goes all the way back.
    fn trace(&self, block: &mut Block, pixels: &[Pixel], transposed: &Transposed, part: &mut Contribution) {
        let (mut segments, mut jitter) = (vec![], vec![]);
        for &pixel in pixels {
            let view = &self.views[pixel.view];
            for (px, py, shift) in self.sampler.sub_rays(pixel, view.supersample, u64::from(self.step)) {
                segments.push(Segment::new(&self.field.space, &view.camera, px, py));
                jitter.push(shift);
            }
        }
        let seen = block.forward(&self.field, &segments, &jitter);
        let (d_seen, loss, squared_error) = self.compare(pixels, seen);
        let regularizer = self.regularizer(segments.len() as f32 / pixels.len() as f32);
        block.backward(&self.field, transposed, &segments, &d_seen, regularizer, &mut part.gradient);
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

    /// Sums the gradients in the order of the parts and takes a step down.
    fn descend(&mut self, parts: &[Contribution]) {
        let rates = Rates::new(self.rate() as f32);
        let (d_weights, weights) = (sum_weights(parts), &mut self.field.network.weights);
        update_dense(weights, &d_weights, &mut self.network_moments, &rates, self.step + 1, self.options.l2 as f32);
        let levels = &self.field.levels;
        let moments = self.table_moments.split(levels.iter().map(|level| level.entries));
        let (mut table, mut d_table) = (&mut self.field.table[..], &mut self.d_table[..]);
        let tables = levels.iter().map(|level| {
            let table = table.split_off_mut(..level.entries).unwrap_or_default();
            (table, d_table.split_off_mut(..level.entries).unwrap_or_default())
        });
        // Levels are disjoint, so each is one task and no two write to the same entry.
        let tasks: Vec<_> = tables.zip(moments).enumerate().collect();
        tasks.into_par_iter().with_max_len(1).for_each(|(l, ((table, d_table), moments))| {
            for part in parts {
                encode_backward(&levels[l], &part.gradient.positions, &part.gradient.levels[l], d_table);
            }
            update_sparse(table, d_table, moments, &rates);
        });
    }

    /// The learning rate of the coming step.
    fn rate(&self) -> f64 {
        let options = &self.options;
        let rise = f64::from(self.step + 1) / f64::from(options.warm_up.max(1));
        let progress = f64::from(self.step) / f64::from(options.steps.max(1));
        options.rate * rise.min(1.0) * options.final_rate.powf(progress.min(1.0))
    }
}

impl Contribution {
    fn clear(&mut self, field: &Field) {
        let mut gradient = std::mem::take(&mut self.gradient);
        gradient.clear(field);
        *self = Self { gradient, ..Self::default() };
    }
}

/// The gradient to the networks' weights: a sum over parts in their order.
fn sum_weights(parts: &[Contribution]) -> Vec<f32> {
    let mut sum = vec![0.0; parts.first().map_or(0, |part| part.gradient.weights.len())];
    for part in parts {
        sum.iter_mut().zip(&part.gradient.weights).for_each(|(sum, d)| *sum += d);
    }
    sum
}
