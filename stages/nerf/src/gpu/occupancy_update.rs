//! Keeps the occupancy grid of a field on a GPU true while the field changes: the same cells and
//! the same points in them as on the CPU.

use super::params::{Draw, Span, Update};
use super::resident::Resident;
use super::trace::{TURNS, start};
use crate::field::Field;
use compute::kernels::{Buffer, Gpu, zeros};
use compute::rng::Rng;

/// Updates that measure every cell, before sampling starts.
const WARM_UP: u32 = 16;
/// What a cell keeps of its value when it is measured again.
const DECAY: f32 = 0.95;
/// Workgroups that take turns at drawing cells.
const DRAWING: u32 = 64;

/// The cells that some camera sees, a bit each, and how many there are before each word.
pub struct GpuOccupancyUpdate {
    seen: Buffer,
    before_seen: Buffer,
    words: usize,
}

impl GpuOccupancyUpdate {
    /// For a field whose cells have been marked as seen or not.
    pub fn new(resident: &Resident, field: &Field) -> Self {
        let words = field.occupancy.cells().div_ceil(32);
        let mut seen = vec![0u32; words];
        field
            .occupancy
            .seen_cells()
            .into_iter()
            .for_each(|cell| seen[cell as usize / 32] |= 1 << (cell % 32));
        let seen = resident.gpu.upload(bytemuck::cast_slice(&seen));
        let before_seen = scan(resident, &seen, words);
        Self {
            seen,
            before_seen,
            words,
        }
    }

    /// Updates the grid and what follows from it. `round` is how many updates came before: it
    /// decides which cells are drawn.
    pub fn update(&self, resident: &Resident, field: &Field, rng: &Rng, round: u32) {
        if round < WARM_UP {
            self.fold_fresh(resident, field, [&self.seen, &self.before_seen], rng, round);
        } else {
            let marked = self.draw(resident, rng, round);
            self.fold_fresh(
                resident,
                field,
                [&marked, &scan(resident, &marked, self.words)],
                rng,
                round,
            );
        }
        resident.refresh();
    }

    /// Some of the seen cells and some of the occupied ones.
    fn draw(&self, resident: &Resident, rng: &Rng, round: u32) -> Buffer {
        let gpu = &*resident.gpu;
        let [low, high] = rng.key();
        // A set, so that a cell that is drawn twice is measured once.
        let marked = zeros(gpu, self.words);
        let occupied = scan(resident, &resident.bits, self.words);
        for (part, set) in [
            (0, [&self.seen, &self.before_seen]),
            (1, [&resident.bits, &occupied]),
        ] {
            let draw = Draw {
                words: self.words as u32,
                // As on the CPU: an update has four steps of the stream, the first for points and
                // the last for draws.
                step: 4 * round + 3,
                part,
                key_low: low,
                key_high: high,
            };
            start(
                gpu,
                &resident.programs.pick,
                &[set[0], set[1], &marked],
                draw,
                DRAWING,
            );
        }
        marked
    }

    /// Folds fresh optical depths of a set of cells into the grid.
    fn fold_fresh(
        &self,
        resident: &Resident,
        field: &Field,
        set: [&Buffer; 2],
        rng: &Rng,
        round: u32,
    ) {
        let grid = &field.occupancy;
        let [low, high] = rng.key();
        let update = Update {
            words: self.words as u32,
            levels: field.levels.len() as u32,
            step: 4 * round,
            key_low: low,
            key_high: high,
            // As on the CPU, the first update forgets what was no measurement.
            decay: if round == 0 { 0.0 } else { DECAY },
            shortest: field.stride().shortest,
            resolution: grid.resolution,
            size_x: grid.size[0] as u32,
            size_y: grid.size[1] as u32,
        };
        let Resident {
            gpu,
            programs,
            levels,
            table,
            weights,
            values,
            ..
        } = resident;
        let arrays = [set[0], set[1], levels, table, weights, values];
        start(gpu, &programs.occupancy_update, &arrays, update, TURNS);
    }
}

/// Members before every word of a set of cells.
fn scan(resident: &Resident, members: &Buffer, words: usize) -> Buffer {
    let gpu: &Gpu = &resident.gpu;
    let before = gpu.buffer(words + 1);
    start(
        gpu,
        &resident.programs.scan_bits,
        &[members, &before],
        Span {
            len: words as u32,
            first: 0,
        },
        1,
    );
    before
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FieldConfig;
    use crate::pool::Pool;
    use compute::testing;

    #[test]
    fn the_grid_is_that_of_the_cpu_during_the_warm_up_and_behind() {
        let Some(device) = testing::gpu() else { return };
        let config = FieldConfig {
            levels: 3,
            log2_table: 8,
            occupancy_resolution: 9,
            ..Default::default()
        };
        let mut field = Field::new(&config, [[0.0; 3], [2.0, 1.0, 1.5]], 5);
        let cells = field.occupancy.cells();
        field
            .occupancy
            .set_seen(&(0..cells).map(|cell| cell % 3 > 0).collect::<Vec<_>>());
        let resident = Resident::new(device.open_gpu().unwrap(), &field);
        let occupancy_update = GpuOccupancyUpdate::new(&resident, &field);
        let rng = Rng::new(3, "survey test");
        for round in 0..24 {
            occupancy_update.update(&resident, &field, &rng, round);
            crate::occupancy_update::update(&mut field, &rng, &Pool::default());
        }
        let values = resident.gpu.read(&resident.values, cells);
        for (cell, (got, expected)) in values.iter().zip(&field.occupancy.values).enumerate() {
            assert!(
                (got - expected).abs() <= 1e-5 * expected.abs(),
                "cell {cell}: {got} beside {expected}"
            );
        }
        let bits = resident.gpu.read(&resident.bits, cells.div_ceil(32));
        let occupied = |cell: &u32| bits[*cell as usize / 32].to_bits() >> (cell % 32) & 1 == 1;
        let got: Vec<u32> = (0..cells as u32).filter(occupied).collect();
        assert_eq!(got, field.occupancy.occupied_cells());
    }
}
