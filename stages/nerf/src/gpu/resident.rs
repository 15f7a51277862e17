//! A field in the memory of a GPU. Knows where its parts lie there, and nothing of rays or
//! training.

use super::params::{Cells, Pass};
use super::programs::Programs;
use crate::field::Field;
use crate::kernels::hash::Entry;
use crate::network::Network;
use bytemuck::Zeroable;
use compute::kernels::{Buffer, Gpu, Job, folded};
use half::f16;
use std::sync::Arc;

/// A field in the memory of a GPU.
pub struct Resident {
    /// The device that holds all that follows.
    pub gpu: Arc<Gpu>,
    /// Kernels for fields of this shape.
    pub programs: Programs,
    /// Hash levels: scale, vertices along the axes, whether they are dense, entries and those of
    /// coarser levels.
    pub levels: Buffer,
    /// A pair of halves per entry.
    pub table: Buffer,
    /// All matrices as [inputs, outputs], then all as [outputs, inputs].
    pub weights: Buffer,
    /// Optical depths of the occupancy cells.
    pub values: Buffer,
    /// A bit per cell that is occupied.
    pub bits: Buffer,
    /// How many cells there are.
    pub cells: usize,
    geometry: Pass,
    /// The most samples that a ray can have.
    pub most_steps: usize,
}

impl Resident {
    /// Moves a field to a GPU.
    pub fn new(gpu: &Arc<Gpu>, field: &Field) -> Self {
        let cells = field.occupancy.cells();
        let resident = Self {
            programs: Programs::new(&field.network),
            levels: gpu.upload(bytemuck::cast_slice(&levels(field))),
            table: gpu.upload(bytemuck::cast_slice(&pairs(&field.table))),
            weights: gpu.upload(bytemuck::cast_slice(&both_ways(&field.network))),
            values: gpu.upload(bytemuck::cast_slice(&field.occupancy.values)),
            bits: gpu.buffer(cells.div_ceil(32)),
            geometry: geometry(field),
            most_steps: most_steps(field),
            gpu: gpu.clone(),
            cells,
        };
        // The bits follow from the values that were just moved.
        resident.refresh();
        resident
    }

    /// Rebuilds the bits of occupied cells from the values.
    pub fn refresh(&self) {
        let gpu = &self.gpu;
        let programs = &self.programs;
        let params = Cells {
            cells: self.cells as u32,
        };
        let threshold = gpu.buffer(1);
        let arrays = [&self.values, &threshold];
        gpu.run(&Job {
            kernel: &programs.threshold,
            arrays: &arrays,
            params,
            groups: [1; 3],
            operations: 0,
        });
        let arrays = [&self.values, &threshold, &self.bits];
        // An invocation writes a word of 32 cells by itself, so that no atomics are needed.
        let groups = folded(self.cells.div_ceil(32 * 256));
        gpu.run(&Job {
            kernel: &programs.occupy,
            arrays: &arrays,
            params,
            groups,
            operations: 0,
        });
    }

    /// What the kernels that follow rays are told: of `count` rays from `first` on.
    pub fn pass(&self, first: usize, count: usize) -> Pass {
        Pass {
            rays: count as u32,
            first: first as u32,
            ..self.geometry
        }
    }
}

fn levels(field: &Field) -> Vec<u32> {
    let words = field.levels.iter().map(|level| {
        let [nx, ny, _] = level.resolution;
        [
            level.scale.to_bits(),
            nx,
            ny,
            level.dense.into(),
            level.entries as u32,
            level.offset as u32,
        ]
    });
    words.flatten().collect()
}

/// Hash entries as the kernels read them.
fn pairs(table: &[Entry]) -> Vec<u32> {
    table
        .iter()
        .map(|&[a, b]| u32::from(a.to_bits()) | u32::from(b.to_bits()) << 16)
        .collect()
}

/// Hash entries from what the kernels read, as they are read back.
pub fn entries(pairs: impl Iterator<Item = u32>) -> Vec<Entry> {
    pairs
        .map(|pair| [pair as u16, (pair >> 16) as u16].map(f16::from_bits))
        .collect()
}

fn both_ways(network: &Network) -> Vec<f32> {
    [&network.weights[..], network.transposed().values()].concat()
}

/// A pass without rays: levels, marching and the occupancy grid.
fn geometry(field: &Field) -> Pass {
    let stride = field.stride();
    let grid = &field.occupancy;
    let [size_x, size_y, size_z] = grid.size.map(|n| n as u32);
    Pass {
        levels: field.levels.len() as u32,
        shortest: stride.shortest,
        cone: stride.cone,
        resolution: grid.resolution,
        size_x,
        size_y,
        size_z,
        ..Pass::zeroed()
    }
}

/// Steps along the box's diagonal, and one more at either end.
fn most_steps(field: &Field) -> usize {
    let diagonal = field
        .space
        .extent
        .iter()
        .map(|side| side * side)
        .sum::<f32>()
        .sqrt();
    // No step is shorter than the shortest, and no ray longer than the diagonal.
    (diagonal / field.stride().shortest).ceil() as usize + 2
}
