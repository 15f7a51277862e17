//! Fits a field to photos: batches, gradients, optimiser, occupancy. Knows nothing of how a ray is
//! traced or a kernel runs.

use crate::adam::table::{SparseMoments, update_sparse};
use crate::adam::{Moments, update_dense};
use crate::batch::{Sampler, TrainView};
use crate::config::FEATURES;
use crate::contribution::{Batch, Contribution};
use crate::corrections::Corrections;
use crate::exposure::{Exposure, Exposures};
use crate::features::{Features, LookUp};
use crate::field::Field;
use crate::kernels::hash::encode_backward;
use crate::loss::psnr;
use crate::occupancy_update::{self, UpdateScratch};
use crate::options::TrainOptions;
use crate::pool::Pool;
use crate::volume_rendering::VolumeRenderer;
use compute::rng::Rng;
use formats::Camera;
use rayon::prelude::*;

/// Parts of a batch whose gradients are summed in order; fixed, so that sums do not depend on the
/// number of threads.
const PARTS: u32 = 32;
/// Rays that go from the features to the gradients together: their activations stay in the
/// second-level cache.
const RAYS_PER_BUNDLE: usize = 16;
/// Pixels of the first batch, and the fewest of any.
const PIXELS: [u32; 2] = [64, 16];
/// Rays of the largest batch.
const MOST_RAYS: u32 = 1 << 16;
/// Steps between updates of the occupancy grid.
pub(crate) const OCCUPANCY_EVERY: u32 = 16;

/// What a training step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// The photometric loss: smooth L1, mean over the batch's pixels and channels, with the views'
    /// weights.
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
    pub(crate) views: Vec<TrainView>,
    pub(crate) corrections: Corrections,
    pub(crate) sampler: Sampler,
    pub(crate) occupancy_rng: Rng,
    /// The field stays as it is: only what is learnt about the views changes.
    frozen: bool,
    parts: Vec<Contribution>,
    features: Features,
    renderers: Pool<VolumeRenderer>,
    update_scratch: Pool<UpdateScratch>,
    /// The gradient to one level's entries; zero between steps.
    d_tables: Pool<Vec<[f32; FEATURES]>>,
}

impl Trainer {
    /// Starts or takes up training of a field. Cells that none of the views sees are emptied for
    /// good.
    ///
    /// Panics if a view's sizes do not fit together or there is no view.
    pub fn new(mut field: Field, views: Vec<TrainView>, options: &TrainOptions, seed: u64) -> Self {
        occupancy_update::mark_unseen_cells(
            &mut field,
            &views.iter().map(|view| &view.camera).collect::<Vec<_>>(),
        );
        Self::begin(field, views, options, seed)
    }

    /// Learns about the views alone, by a field that stays as it is. The field holds the cameras in
    /// place, so what they have in common is not taken back.
    ///
    /// Panics as [`Trainer::new`] does.
    pub(crate) fn of_views(
        field: Field,
        views: Vec<TrainView>,
        options: &TrainOptions,
        seed: u64,
    ) -> Self {
        let mut trainer = Self::begin(field, views, options, seed);
        trainer.frozen = true;
        trainer.corrections.trust_field();
        trainer
    }

    fn begin(field: Field, views: Vec<TrainView>, options: &TrainOptions, seed: u64) -> Self {
        assert!(!views.is_empty(), "training needs at least one view");
        views.iter().for_each(TrainView::check);
        Self {
            step: 0,
            pixels: PIXELS[0],
            table_moments: SparseMoments::new(&field.table),
            network_moments: Moments::new(field.network.weights.len()),
            sampler: Sampler::new(&views, seed),
            occupancy_rng: Rng::new(seed, "occupancy update"),
            frozen: false,
            parts: (0..PARTS).map(|_| Contribution::default()).collect(),
            features: Features::default(),
            renderers: Pool::default(),
            update_scratch: Pool::default(),
            d_tables: Pool::default(),
            options: options.clone(),
            corrections: Corrections::new(options, &views),
            field,
            views,
        }
    }

    /// The field as it is now.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Ends training, and drops the moments.
    pub fn into_field(self) -> Field {
        self.field
    }

    /// The cameras of the views, in their order, as they are now.
    pub fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(|view| view.camera).collect()
    }

    /// How the views were exposed, in their order; `None` where that is not learnt.
    pub fn exposures(&self) -> Option<Vec<Exposure>> {
        self.corrections.exposures.as_ref().map(Exposures::all)
    }

    /// Steps taken so far.
    pub fn steps_taken(&self) -> u32 {
        self.step
    }

    /// One training step. If the loss is not a finite number, nothing is learnt from it: the field
    /// stays as it was.
    pub fn step(&mut self) -> StepStats {
        let mut parts = std::mem::take(&mut self.parts);
        self.contribute(&mut parts);
        let stats = self.stats(&parts);
        // One bad batch (an infinite density, say) must not put NaN into moments that live for
        // thousands of steps.
        if stats.loss.is_finite() {
            if !self.frozen {
                self.descend(&parts);
            }
            let view_gradients = parts.iter().map(|part| &part.view_gradients);
            self.corrections
                .descend(view_gradients, &self.options, self.step, &mut self.views);
        }
        self.step += 1;
        if !self.frozen && self.step.is_multiple_of(OCCUPANCY_EVERY) {
            occupancy_update::update(&mut self.field, &self.occupancy_rng, &self.update_scratch);
        }
        self.pixels = self.next_pixels(stats.samples);
        self.parts = parts;
        stats
    }

    fn stats(&self, parts: &[Contribution]) -> StepStats {
        let count = f64::from(self.pixels) * 3.0;
        StepStats {
            loss: parts.iter().map(|part| part.loss).sum::<f64>() / count,
            psnr: psnr(parts.iter().map(|part| part.squared_error).sum::<f64>() / count),
            rays: parts.iter().map(|part| part.samples.rays.len()).sum(),
            samples: parts.iter().map(|part| part.samples.t.len()).sum(),
        }
    }

    /// Rays of a pixel of the view that has the most.
    fn rays_per_pixel(&self) -> usize {
        self.views
            .iter()
            .map(TrainView::rays_per_pixel)
            .max()
            .unwrap_or(1)
    }

    /// Pixels of the next batch, for the wanted number of samples that rays see. At most twice or
    /// half as many as before.
    pub(crate) fn next_pixels(&self, samples: usize) -> u32 {
        let wanted =
            u64::from(self.pixels) * u64::from(self.options.samples) / (samples as u64).max(1);
        // The samples a pixel needs fall as the grid empties; a jump would make the rate per pixel
        // jump.
        let near = wanted.clamp(u64::from(self.pixels / 2), u64::from(self.pixels) * 2) as u32;
        self.within_limits(near.next_multiple_of(PIXELS[1]))
    }

    /// The nearest number of pixels that a batch may have.
    pub(crate) fn within_limits(&self, pixels: u32) -> u32 {
        pixels.clamp(PIXELS[1], MOST_RAYS / self.rays_per_pixel() as u32)
    }

    /// Gradients of the batch, part by part; features are looked up for all parts together, level
    /// by level.
    fn contribute(&mut self, parts: &mut [Contribution]) {
        let per_bundle = (RAYS_PER_BUNDLE / self.rays_per_pixel()).max(1);
        let transposed = self.field.network.transposed();
        let Self {
            field,
            views,
            sampler,
            corrections,
            options,
            step,
            pixels,
            features,
            renderers,
            ..
        } = self;
        let batch = Batch {
            field,
            views,
            sampler,
            corrections,
            options,
            step: *step,
            pixels: *pixels,
            transposed: &transposed,
        };
        parts
            .par_iter_mut()
            .enumerate()
            .for_each(|(part, contribution)| {
                let start =
                    |part: u32| (u64::from(part) * u64::from(*pixels) / u64::from(PARTS)) as u32;
                batch.march(start(part as u32)..start(part as u32 + 1), contribution);
            });
        features.clear(field);
        // Rays ask for a few samples at a time, since most end early at a surface. All parts'
        // questions of one turn are looked up level by level: a level's table stays in the cache
        // for all of them.
        while parts
            .iter_mut()
            .map(|part| part.termination.request(features))
            .max()
            == Some(true)
        {
            let look_ups: Vec<LookUp<'_>> = features.look_ups(field).collect();
            look_ups
                .into_par_iter()
                .with_max_len(1)
                .for_each(LookUp::run);
            parts.par_iter_mut().for_each(
                |Contribution {
                     termination,
                     samples,
                     ..
                 }| {
                    renderers.lend(|renderer| {
                        termination.advance(field, samples, features, &mut renderer.activations)
                    });
                },
            );
        }
        parts.par_iter_mut().for_each(|part| {
            renderers.lend(|renderer| batch.learn(features, per_bundle, renderer, part))
        });
    }

    /// Sums the gradients in the order of the parts and takes a step down.
    fn descend(&mut self, parts: &[Contribution]) {
        let rate = self.options.rate_after(self.step) as f32;
        let d_weights = sum_weights(parts);
        let weights = &mut self.field.network.weights;
        update_dense(
            weights,
            &d_weights,
            &mut self.network_moments,
            rate,
            self.step + 1,
            self.options.l2 as f32,
        );
        let levels = &self.field.levels;
        let moments = self
            .table_moments
            .split(levels.iter().map(|level| level.entries));
        let mut table = &mut self.field.table[..];
        let d_tables = &self.d_tables;
        let tables = levels
            .iter()
            .map(|level| table.split_off_mut(..level.entries).unwrap_or_default());
        // Levels are disjoint, so each is one task and no two write to the same entry.
        let tasks: Vec<_> = levels.iter().zip(tables).zip(moments).enumerate().collect();
        tasks
            .into_par_iter()
            .with_max_len(1)
            .for_each(|(l, ((level, table), moments))| {
                d_tables.lend(|d_table| {
                    // Never shrunk: what lies beyond this level's entries stays zero for a larger
                    // level.
                    d_table.resize(d_table.len().max(level.entries), [0.0; FEATURES]);
                    let d_table = &mut d_table[..level.entries];
                    for part in parts {
                        encode_backward(
                            level,
                            part.gradient.positions.since(0),
                            &part.gradient.levels[l],
                            d_table,
                        );
                    }
                    update_sparse(table, d_table, moments, rate);
                });
            });
    }
}

/// The gradient to the networks' weights: a sum over parts in their order.
fn sum_weights(parts: &[Contribution]) -> Vec<f32> {
    let mut sum = vec![0.0; parts.first().map_or(0, |part| part.gradient.weights.len())];
    for part in parts {
        sum.iter_mut()
            .zip(&part.gradient.weights)
            .for_each(|(sum, d)| *sum += d);
    }
    sum
}
