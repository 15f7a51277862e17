//! Adam's state of a field in training on a GPU, and its steps. Knows the CPU's trainer, whose
//! numbers it takes over and gives back.

use super::params::{NetworkStep, TableStep};
use super::resident::Resident;
use super::trace::{by_256, start};
use super::work::PARTS;
use crate::adam::{CORRECTED, correction};
use crate::train::Trainer;
use compute::kernels::{Buffer, Gpu, Job, folded};

/// Adam's moments and the values that steps are taken on, on the device.
pub struct GpuMoments {
    /// First, then second moments of the networks' weights.
    network: Buffer,
    /// The table's values and their moments, of which a word holds an entry's two.
    values: Buffer,
    first: Buffer,
    second: Buffer,
    steps: Buffer,
    /// Bias corrections by the number of steps.
    corrections: Buffer,
}

/// What a step goes by.
#[derive(Clone, Copy)]
pub struct Gradients<'a> {
    /// Those to the networks' weights, [`PARTS`] sums one behind the other.
    pub parts: &'a Buffer,
    /// Those to the table.
    pub table: &'a Buffer,
    /// The loss and the counts: where the loss is no number, no step is taken. The kernels read it, so
    /// that the host need not wait to know.
    pub stats: &'a Buffer,
}

impl GpuMoments {
    /// Those of a trainer on the CPU.
    pub fn new(gpu: &Gpu, host: &Trainer) -> Self {
        let table = &host.table_moments;
        let network = &host.network_moments;
        // WGSL has no integers of 16 bits.
        let steps: Vec<u32> = table.steps.iter().map(|&n| n.into()).collect();
        let corrections: Vec<f32> = (1..=CORRECTED as i32)
            .map(|n| correction(n) as f32)
            .collect();
        Self {
            network: gpu.upload(bytemuck::cast_slice(
                &[&network.first[..], &network.second].concat(),
            )),
            values: gpu.upload(bytemuck::cast_slice(&table.values)),
            first: gpu.upload(bytemuck::cast_slice(&table.first)),
            second: gpu.upload(bytemuck::cast_slice(&table.second)),
            steps: gpu.upload(bytemuck::cast_slice(&steps)),
            corrections: gpu.upload(bytemuck::cast_slice(&corrections)),
        }
    }

    /// A step down, of networks and table.
    pub fn descend(&self, gpu: &Gpu, resident: &Resident, host: &Trainer, by: Gradients) {
        let rate = host.options.rate_after(host.step);
        let step = NetworkStep {
            parts: PARTS,
            // All weights have taken the same number of steps, so that one correction does for
            // them.
            rate: (rate * correction(host.step as i32 + 1)) as f32,
            l2: host.options.l2 as f32,
        };
        start(
            gpu,
            &resident.programs.adam_network,
            &[by.parts, by.stats, &resident.weights, &self.network],
            step,
            by_256(host.field.network.weights.len()),
        );
        let entries = host.field.table.len();
        gpu.start(&Job {
            kernel: &resident.programs.adam_table,
            arrays: &[
                by.stats,
                &self.corrections,
                by.table,
                &self.values,
                &self.first,
                &self.second,
                &self.steps,
                &resident.table,
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

    /// Gives the state back to the trainer on the CPU.
    pub fn fetch(&self, gpu: &Gpu, host: &mut Trainer) {
        let entries = host.field.table.len();
        let weights = host.field.network.weights.len();
        // Arrays come back as f32; here only their bits count.
        let words = |buffer: &Buffer| gpu.read(buffer, entries).into_iter().map(f32::to_bits);
        let packed = |buffer: &Buffer| {
            words(buffer)
                .map(|word| [word as u16, (word >> 16) as u16])
                .collect()
        };
        let values = gpu.read(&self.values, 2 * entries);
        host.table_moments.values = values.as_chunks().0.to_vec();
        host.table_moments.first = packed(&self.first);
        host.table_moments.second = packed(&self.second);
        host.table_moments.steps = words(&self.steps).map(|n| n as u16).collect();
        let mut network = gpu.read(&self.network, 2 * weights);
        host.network_moments.second = network.split_off(weights);
        host.network_moments.first = network;
    }
}
