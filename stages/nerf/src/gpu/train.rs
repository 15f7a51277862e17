//! Training of a field on a GPU: batches are drawn by the host, all else is done on the device.
//! Knows the CPU's trainer, whose numbers it takes over and gives back, so that states and fields
//! are the same format.

use super::batch::Batch;
use super::params::{NetworkStep, Outcome, Pass, TableStep};
use super::resident::{Resident, entries};
use super::survey::Survey;
use super::trace::{Rays, Traced, by_256, start};
use super::work::{self, Extent, Work};
use crate::adam::{CORRECTED, correction};
use crate::field::Field;
use crate::loss::psnr;
use crate::tensors::Tensors;
use crate::train::{OCCUPANCY_EVERY, StepStats, Trainer};
use compute::kernels::{Buffer, Gpu, Job, Requested, folded, zeros};
use std::sync::Arc;

/// Workgroups that take turns at the samples of a backward pass, each with a sum of its own of the
/// gradient to the weights.
pub const PARTS: u32 = 256;

/// A field in training on a GPU.
pub struct GpuTrainer {
    /// Options, views, random numbers and counters; its field and moments are those of the last
    /// [`GpuTrainer::fetch`].
    host: Trainer,
    gpu: Arc<Gpu>,
    resident: Resident,
    survey: Survey,
    moments: Moments,
    /// Gradient to the table, two numbers of two words per entry.
    d_table: Buffer,
    /// Bias corrections by the number of steps.
    corrections: Buffer,
    /// What the last step gave the kernels to do.
    work: Vec<(&'static str, Work)>,
}

/// Adam's state.
struct Moments {
    /// First, then second moments of the networks' weights.
    network: Buffer,
    /// The table's values and their moments, of which a word holds an entry's two.
    values: Buffer,
    first: Buffer,
    second: Buffer,
    steps: Buffer,
}

impl Moments {
    fn new(gpu: &Gpu, host: &Trainer) -> Self {
        let table = &host.table_moments;
        let network = &host.network_moments;
        let steps: Vec<u32> = table.steps.iter().map(|&n| n.into()).collect();
        Self {
            network: gpu.upload(bytemuck::cast_slice(
                &[&network.first[..], &network.second].concat(),
            )),
            values: gpu.upload(bytemuck::cast_slice(&table.values)),
            first: gpu.upload(bytemuck::cast_slice(&table.first)),
            second: gpu.upload(bytemuck::cast_slice(&table.second)),
            steps: gpu.upload(bytemuck::cast_slice(&steps)),
        }
    }
}

impl GpuTrainer {
    /// Goes on from where a trainer on the CPU stands.
    pub fn new(gpu: &Arc<Gpu>, host: Trainer) -> Self {
        let resident = Resident::new(gpu, &host.field);
        let corrections: Vec<f32> = (1..=CORRECTED as i32)
            .map(|n| correction(n) as f32)
            .collect();
        Self {
            survey: Survey::new(&resident, &host.field),
            moments: Moments::new(gpu, &host),
            d_table: zeros(gpu, 4 * host.field.table.len()),
            corrections: gpu.upload(bytemuck::cast_slice(&corrections)),
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

    /// Ends training.
    pub fn into_field(mut self) -> Field {
        self.fetch();
        self.host.into_field()
    }

    /// One training step. Returns when its loss is known, while the device still learns from it.
    pub fn step(&mut self) -> StepStats {
        let batch = Batch::draw(&self.host, &self.resident);
        let parts = self
            .gpu
            .buffer(PARTS as usize * self.host.field.network.weights.len());
        let (stats, asked) = self.learn(&batch, &parts);
        self.descend(&parts, &stats);
        self.host.step += 1;
        if self.host.step.is_multiple_of(OCCUPANCY_EVERY) {
            let round = self.host.field.occupancy.updates;
            self.survey.update(
                &self.resident,
                &self.host.field,
                &self.host.survey_rng,
                round,
            );
            self.host.field.occupancy.updates += 1;
        }
        self.gpu.submit();
        self.finish(batch.rays.count, &self.gpu.receive(asked))
    }

    /// Gradients of the batch, and what it came to, which is asked for before the last way back.
    fn learn(&self, batch: &Batch, parts: &Buffer) -> (Buffer, Requested) {
        let gpu = &*self.gpu;
        let stats = self.gpu.buffer(4);
        let mut asked = None;
        for (i, pass) in batch.passes.iter().enumerate() {
            let traced = self.resident.trace(&batch.rays, pass.clone());
            let d_raw = self.compare(batch, &traced, pass.len());
            if i + 1 == batch.passes.len() {
                let outcome = Outcome {
                    rays: batch.rays.count as u32,
                    pixels: batch.count as u32,
                };
                let arrays = [&batch.losses, &batch.rays.seen, &batch.rays.looked, &stats];
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
        let asked = asked.unwrap_or_else(|| gpu.request(&stats, 4));
        (stats, asked)
    }

    /// Losses of the pixels of a pass, and gradients to the raw densities and colours of its
    /// samples.
    fn compare(&self, batch: &Batch, traced: &Traced, rays: usize) -> Buffer {
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
        let Batch {
            rays: Rays { buffer, views, .. },
            pixels,
            losses,
            ..
        } = batch;
        let arrays = [
            buffer,
            &traced.before,
            &traced.samples,
            &traced.raw,
            views,
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

    /// A step down, unless the loss is no number.
    fn descend(&self, parts: &Buffer, stats: &Buffer) {
        let Self {
            gpu,
            resident:
                Resident {
                    programs,
                    table,
                    weights,
                    ..
                },
            moments,
            host,
            ..
        } = self;
        let rate = host.options.rate_after(host.step);
        let count = host.field.network.weights.len();
        let step = NetworkStep {
            parts: PARTS,
            rate: (rate * correction(host.step as i32 + 1)) as f32,
            l2: host.options.l2 as f32,
        };
        start(
            gpu,
            &programs.adam_network,
            &[parts, stats, weights, &moments.network],
            step,
            by_256(count),
        );
        let entries = host.field.table.len();
        let Moments {
            values,
            first,
            second,
            steps,
            ..
        } = moments;
        gpu.start(&Job {
            kernel: &programs.adam_table,
            arrays: &[
                stats,
                &self.corrections,
                &self.d_table,
                values,
                first,
                second,
                steps,
                table,
            ],
            params: TableStep {
                entries: entries as u32,
                rate: rate as f32,
                corrected: CORRECTED as u32,
            },
            groups: folded(entries.div_ceil(256)),
            operations: 0,
        });
    }

    /// What the step came to, and the size of the next batch.
    fn finish(&mut self, rays: usize, stats: &[f32]) -> StepStats {
        let host = &mut self.host;
        let [loss, squared_error, samples, looked] = [0, 1, 2, 3].map(|i| stats[i]);
        let [samples, looked] = [samples, looked].map(|count| count.to_bits() as usize);
        let extent = Extent {
            rays,
            pixels: host.pixels as usize,
            looked,
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
        let entries_count = host.field.table.len();
        let weights = host.field.network.weights.len();
        let words = |buffer: &Buffer| {
            gpu.read(buffer, entries_count)
                .into_iter()
                .map(f32::to_bits)
        };
        let packed = |buffer: &Buffer| {
            words(buffer)
                .map(|word| [word as u16, (word >> 16) as u16])
                .collect()
        };
        host.field.table = entries(words(&resident.table));
        host.table_moments.values = gpu
            .read(&moments.values, 2 * entries_count)
            .as_chunks()
            .0
            .to_vec();
        host.table_moments.first = packed(&moments.first);
        host.table_moments.second = packed(&moments.second);
        host.table_moments.steps = words(&moments.steps).map(|n| n as u16).collect();
        host.field.network.weights = gpu.read(&resident.weights, weights);
        let mut network = gpu.read(&moments.network, 2 * weights);
        host.network_moments.second = network.split_off(weights);
        host.network_moments.first = network;
        host.field.occupancy.values = gpu.read(&resident.values, resident.cells);
        host.field.occupancy.refresh();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::TrainView;
    use crate::config::FieldConfig;
    use crate::options::TrainOptions;
    use compute::{Device, testing};
    use formats::{Camera, Pixels};

    /// Losses of a few steps whose batches are traced in passes, as if a ray might have so many
    /// samples.
    fn losses(device: &Device, most_steps: Option<usize>) -> Vec<f64> {
        let config = FieldConfig {
            levels: 2,
            log2_table: 8,
            march_steps: 16,
            ..Default::default()
        };
        let pose = glam::DMat4::from_translation(glam::DVec3::new(0.5, 0.5, 2.0));
        let camera = Camera::centered((8, 8), 8.0, pose, [1.0, 2.0]);
        let rgb = (0..192).map(|i| (i % 7) as f32 / 7.0).collect();
        let view = TrainView {
            camera,
            pixels: Pixels::opaque(rgb),
            mask: None,
            weight: 1.0,
            supersample: 1,
        };
        let field = Field::new(&config, [[0.0; 3], [1.0; 3]], 1);
        let host = Trainer::new(
            field,
            vec![view],
            &TrainOptions {
                samples: 512,
                ..Default::default()
            },
            1,
        );
        let mut trainer = GpuTrainer::new(device.open_gpu().unwrap(), host);
        if let Some(most_steps) = most_steps {
            trainer.resident.most_steps = most_steps;
        }
        (0..6).map(|_| trainer.step().loss).collect()
    }

    #[test]
    fn several_passes_learn_what_one_does() {
        let Some(device) = testing::gpu() else { return };
        let before = device.counts().unwrap();
        let whole = losses(&device, None);
        let of_one = device.counts().unwrap() - before;
        let in_parts = losses(&device, Some(1 << 16));
        let of_parts = device.counts().unwrap() - before - of_one;
        assert!(
            of_parts.dispatches > of_one.dispatches + 60,
            "{of_one:?} {of_parts:?}"
        );
        for (step, (whole, part)) in whole.iter().zip(&in_parts).enumerate() {
            assert!(
                (whole / part - 1.0).abs() < 1e-4,
                "step {step}: {part} beside {whole}"
            );
        }
    }
}
