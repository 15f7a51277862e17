//! Training of a field on a GPU: batches are drawn by the host, all else is done on the device.
//! Knows the CPU's trainer, whose numbers it takes over and gives back, so that states and fields
//! are the same format.

use super::batch::GpuBatch;
use super::moments::{GpuMoments, Gradients};
use super::occupancy_update::GpuOccupancyUpdate;
use super::params::{Outcome, Pass};
use super::resident::{Resident, entries};
use super::trace::{Rays, Traced, by_256, start};
use super::work::{self, Extent, PARTS, Work};
use crate::field::Field;
use crate::loss::psnr;
use crate::tensors::Tensors;
use crate::train::{OCCUPANCY_EVERY, StepStats, Trainer};
use compute::kernels::{Buffer, Gpu, Requested, zeros};
use std::sync::Arc;

/// A field in training on a GPU.
pub struct GpuTrainer {
    /// Options, views, random numbers and counters; its field and moments are those of the last
    /// [`GpuTrainer::fetch`].
    pub(crate) host: Trainer,
    gpu: Arc<Gpu>,
    resident: Resident,
    occupancy_update: GpuOccupancyUpdate,
    moments: GpuMoments,
    /// Gradient to the table, two numbers of two words per entry.
    d_table: Buffer,
    /// What the last step gave the kernels to do.
    work: Vec<(&'static str, Work)>,
}

impl GpuTrainer {
    /// Goes on from where a trainer on the CPU stands.
    pub fn new(gpu: &Arc<Gpu>, host: Trainer) -> Self {
        let resident = Resident::new(gpu, &host.field);
        Self {
            occupancy_update: GpuOccupancyUpdate::new(&resident, &host.field),
            moments: GpuMoments::new(gpu, &host),
            d_table: zeros(gpu, 4 * host.field.table.len()),
            gpu: gpu.clone(),
            work: Vec::new(),
            resident,
            host,
        }
    }

    /// Steps taken so far.
    pub fn steps_taken(&self) -> u32 {
        self.host.step
    }

    /// What the last step gave the kernels to do, by name, without the occupancy grid's update.
    pub fn work(&self) -> &[(&'static str, Work)] {
        &self.work
    }

    /// Everything that the coming steps depend on, as [`Trainer::state`] tells it.
    pub fn state(&mut self) -> Tensors {
        self.fetch();
        self.host.state()
    }

    /// Ends training, and brings the field back to the host.
    pub fn into_field(mut self) -> Field {
        self.fetch();
        self.host.into_field()
    }

    /// One training step. Returns when its loss is known, while the device still learns from it.
    pub fn step(&mut self) -> StepStats {
        let batch = GpuBatch::draw(&self.host, &self.resident);
        // Not cleared: the first pass's kernel writes all of it.
        let parts = self
            .gpu
            .buffer(PARTS as usize * self.host.field.network.weights.len());
        let (stats, asked) = self.learn(&batch, &parts);
        let gradients = Gradients {
            parts: &parts,
            table: &self.d_table,
            stats: &stats,
        };
        self.moments
            .descend(&self.gpu, &self.resident, &self.host, gradients);
        self.host.step += 1;
        if self.host.step.is_multiple_of(OCCUPANCY_EVERY) {
            let round = self.host.field.occupancy.updates;
            self.occupancy_update.update(
                &self.resident,
                &self.host.field,
                &self.host.occupancy_rng,
                round,
            );
            // The host counts, since the step of the random numbers follows from it.
            self.host.field.occupancy.updates += 1;
        }
        // Now, so that the device works while the host waits for the loss.
        self.gpu.submit();
        self.finish(batch.rays.count, &self.gpu.receive(asked))
    }

    /// Gradients of the batch, and what it came to, which is asked for before the last way back.
    fn learn(&self, batch: &GpuBatch, parts: &Buffer) -> (Buffer, Requested) {
        let gpu = &*self.gpu;
        let stats = self.gpu.buffer(4);
        let mut asked = None;
        for (i, pass) in batch.passes.iter().enumerate() {
            let traced = self.resident.trace(&batch.rays, pass.clone());
            let d_raw = self.compare(batch, &traced, pass.len());
            // After the last pass's losses, and before its way back: the host learns of them that
            // much earlier.
            if i + 1 == batch.passes.len() {
                let outcome = Outcome {
                    rays: batch.rays.count as u32,
                    pixels: batch.count as u32,
                };
                let arrays = [&batch.losses, &batch.rays.seen, &batch.rays.queried, &stats];
                start(gpu, &self.resident.programs.stats, &arrays, outcome, 1);
                asked = Some(gpu.request(&stats, 4));
            }
            let Resident {
                programs,
                levels,
                table,
                weights,
                ..
            } = &self.resident;
            let arrays = [
                &batch.rays.buffer,
                &traced.samples,
                &d_raw,
                levels,
                table,
                weights,
                parts,
                &self.d_table,
            ];
            start(gpu, &programs.backward, &arrays, traced.pass, PARTS);
        }
        // Without a pass nothing was asked for yet.
        let asked = asked.unwrap_or_else(|| gpu.request(&stats, 4));
        (stats, asked)
    }

    /// Losses of the pixels of a pass, and gradients to the raw densities and colours of its
    /// samples.
    fn compare(&self, batch: &GpuBatch, traced: &Traced, rays: usize) -> Buffer {
        let options = &self.host.options;
        let pass = Pass {
            pixels: batch.count as u32,
            beta: options.beta as f32,
            distortion: options.distortion as f32,
            fog: options.fog as f32,
            fog_range: options.fog_range as f32,
            ..traced.pass
        };
        let d_raw = self.gpu.buffer(traced.raw.bytes() as usize / 4);
        let GpuBatch {
            rays: Rays {
                buffer, outputs, ..
            },
            pixels,
            losses,
            ..
        } = batch;
        let arrays = [
            buffer,
            &traced.before,
            &traced.samples,
            &traced.raw,
            outputs,
            pixels,
            &d_raw,
            losses,
        ];
        start(
            &self.gpu,
            &self.resident.programs.composite_backward,
            &arrays,
            pass,
            by_256(rays),
        );
        d_raw
    }

    /// What the step came to, and the size of the next batch.
    fn finish(&mut self, rays: usize, stats: &[f32]) -> StepStats {
        let host = &mut self.host;
        let [loss, squared_error, samples, queried] = [0, 1, 2, 3].map(|i| stats[i]);
        let [samples, queried] = [samples, queried].map(|count| count.to_bits() as usize);
        let extent = Extent {
            rays,
            pixels: host.pixels as usize,
            queried,
            samples,
        };
        self.work = work::of_step(&extent, &host.field.levels, &host.field.network);
        self.work
            .iter()
            .for_each(|(_, work)| self.gpu.account(work.operations, work.bytes));
        let count = 3.0 * f64::from(host.pixels);
        host.pixels = host.next_pixels(samples);
        StepStats {
            loss: f64::from(loss) / count,
            psnr: psnr(f64::from(squared_error) / count),
            rays,
            samples,
        }
    }

    /// Brings the field and Adam's state back to the host.
    fn fetch(&mut self) {
        let Self {
            gpu,
            resident,
            moments,
            host,
            ..
        } = self;
        moments.fetch(gpu, host);
        let weights = host.field.network.weights.len();
        let table = gpu.read(&resident.table, host.field.table.len());
        host.field.table = entries(table.into_iter().map(f32::to_bits));
        host.field.network.weights = gpu.read(&resident.weights, weights);
        host.field.occupancy.values = gpu.read(&resident.values, resident.cells);
        // What follows from the values is not read back but made anew.
        host.field.occupancy.refresh();
    }
}

#[cfg(test)]
mod tests;
