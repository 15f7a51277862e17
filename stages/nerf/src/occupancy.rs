//! A grid over the box that says where there may be something to see. Knows densities only as
//! numbers it is handed.

use crate::space::Space;
use rayon::prelude::*;

/// What a cell keeps of its value when it is measured again.
const DECAY: f32 = 0.95;
/// A cell is occupied from this optical depth per marching step on, or from half the mean if that
/// is less: an even haze stays occupied.
const THRESHOLD: f32 = 0.01;
/// The value of a cell not measured yet: occupied, and forgotten at the first update.
const UNKNOWN: f32 = THRESHOLD;
/// The value of cells that no camera sees: they are never filled.
const UNSEEN: f32 = -1.0;
/// Cells that one task goes over; whole words of a set.
const CHUNK: usize = 1 << 13;

/// Cubic cells with a slowly forgetting maximum of the optical depth of one marching step (Müller
/// et al. 2022, appendix C).
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    /// Cells along x, y and z.
    pub size: [usize; 3],
    /// Cells per unit of length.
    pub resolution: f32,
    /// Optical depths, x fastest; negative where no camera looks.
    pub values: Vec<f32>,
    /// Updates so far; the stream of random numbers follows from it.
    pub updates: u32,
    seen: Vec<u64>,
    occupied: Vec<u64>,
}

impl OccupancyGrid {
    /// A grid in which everything may be occupied, with `resolution` cells along the box's longest
    /// side.
    pub fn new(resolution: u32, space: &Space) -> Self {
        let size = space
            .extent
            .map(|side| (side * resolution as f32).ceil().max(1.0) as usize);
        let cells = size.iter().product();
        let values = vec![UNKNOWN; cells];
        let mut grid = Self {
            size,
            resolution: resolution as f32,
            values,
            updates: 0,
            seen: vec![],
            occupied: vec![],
        };
        grid.refresh();
        grid
    }

    /// Number of cells, seen or not.
    pub fn cells(&self) -> usize {
        self.values.len()
    }

    /// The unit-space point at `fraction` of cell `index`.
    pub fn point(&self, index: usize, fraction: [f32; 3]) -> [f32; 3] {
        let [nx, ny, _] = self.size;
        let cell = [index % nx, index / nx % ny, index / (nx * ny)];
        std::array::from_fn(|axis| (cell[axis] as f32 + fraction[axis]) / self.resolution)
    }

    /// Marks the cells that `seen` (by their index) refuses: they stay empty for good. A cell that
    /// was marked before and is seen now starts anew as possibly occupied.
    pub fn set_seen(&mut self, seen: &[bool]) {
        for (value, &seen) in self.values.iter_mut().zip(seen) {
            *value = match (seen, *value < 0.0) {
                (false, _) => UNSEEN,
                (true, true) => UNKNOWN,
                (true, false) => *value,
            };
        }
        self.refresh();
    }

    /// Folds fresh optical depths of some cells into the grid, in order: v = max(0.95 v, fresh).
    pub fn update(&mut self, cells: &[u32], fresh: &[f32]) {
        // The first update forgets UNKNOWN, which is no measurement.
        let decay = if self.updates == 0 { 0.0 } else { DECAY };
        for (&cell, &fresh) in cells.iter().zip(fresh) {
            let value = &mut self.values[cell as usize];
            if *value >= 0.0 {
                *value = (decay * *value).max(fresh);
            }
        }
        self.updates += 1;
        self.refresh();
    }

    /// Rebuilds what follows from the values.
    pub fn refresh(&mut self) {
        self.seen = members(&self.values, 0.0);
        self.occupied = members(&self.values, THRESHOLD.min(0.5 * self.mean()));
    }

    /// Mean over the cells that are seen; 0 if there are none. Summed in parts of fixed size: the
    /// same for any number of threads.
    fn mean(&self) -> f32 {
        let part = |values: &[f32]| {
            let seen = values.iter().filter(|&&v| v >= 0.0);
            seen.fold((0f64, 0u32), |(sum, count), &v| {
                (sum + f64::from(v), count + 1)
            })
        };
        let parts: Vec<_> = self.values.par_chunks(CHUNK).map(part).collect();
        let (sum, count) = parts.iter().fold((0.0, 0), |(sum, count), part| {
            (sum + part.0, count + part.1)
        });
        (sum / f64::from(count.max(1))) as f32
    }

    /// Indices of the occupied cells.
    pub fn occupied_cells(&self) -> Vec<u32> {
        elements(&self.occupied)
    }

    /// Indices of the cells some camera sees.
    pub fn seen_cells(&self) -> Vec<u32> {
        elements(&self.seen)
    }

    #[inline]
    fn is_occupied(&self, cell: usize) -> bool {
        self.occupied[cell / 64] >> (cell % 64) & 1 == 1
    }

    /// The cell of a unit-space point; points outside belong to the nearest cell.
    #[inline]
    pub fn cell(&self, point: [f32; 3]) -> [usize; 3] {
        std::array::from_fn(|axis| {
            ((point[axis] * self.resolution).max(0.0) as usize).min(self.size[axis] - 1)
        })
    }

    /// Whether there may be something in a cell.
    #[inline]
    pub fn occupied(&self, [x, y, z]: [usize; 3]) -> bool {
        self.is_occupied((z * self.size[1] + y) * self.size[0] + x)
    }
}

/// The set of cells whose values are not below a threshold, a bit each.
fn members(values: &[f32], threshold: f32) -> Vec<u64> {
    let word = |values: &[f32]| {
        values
            .iter()
            .rev()
            // Backwards, so that the first cell ends up in the lowest bit.
            .fold(0, |bits, &v| bits << 1 | u64::from(v >= threshold))
    };
    let words = |values: &[f32]| values.chunks(64).map(word).collect::<Vec<u64>>();
    values.par_chunks(CHUNK).flat_map_iter(words).collect()
}

/// The elements of a set, ascending.
pub fn elements(set: &[u64]) -> Vec<u32> {
    let mut elements = Vec::with_capacity(set.iter().map(|word| word.count_ones() as usize).sum());
    for (i, &word) in set.iter().enumerate() {
        let mut rest = word;
        while rest != 0 {
            elements.push(64 * i as u32 + rest.trailing_zeros());
            // Clears the lowest bit that is set.
            rest &= rest - 1;
        }
    }
    elements
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> OccupancyGrid {
        OccupancyGrid::new(4, &Space::new([[0.0; 3], [1.0, 0.5, 0.5]]))
    }

    #[test]
    fn a_new_grid_is_occupied_everywhere_and_has_cubic_cells() {
        let grid = grid();
        assert_eq!((grid.size, grid.cells()), ([4, 2, 2], 16));
        assert_eq!(grid.occupied_cells().len(), 16);
        assert_eq!(grid.point(4 + 1, [0.5; 3]), [0.375, 0.375, 0.125]);
        assert_eq!(grid.cell(grid.point(13, [0.3; 3])), [1, 1, 1]);
    }

    #[test]
    fn values_decay_unless_something_fresh_is_larger() {
        let mut grid = grid();
        grid.update(&[0, 1], &[0.5, 3.0]);
        grid.update(&[0, 1], &[0.1, 0.0]);
        assert_eq!(grid.values[..3], [0.95 * 0.5, 0.95 * 3.0, UNKNOWN]);
        assert_eq!(grid.updates, 2);
    }

    #[test]
    fn cells_fall_empty_below_the_threshold_or_the_mean() {
        let mut grid = grid();
        let all: Vec<u32> = (0..16).collect();
        (0..200).for_each(|_| grid.update(&all, &[0.0; 16]));
        grid.update(&[3], &[0.5]);
        assert_eq!(grid.occupied_cells(), [3], "0.5 is above 0.01");
        (0..200).for_each(|_| grid.update(&all, &[0.0; 16]));
        grid.update(&[5], &[0.004]);
        assert_eq!(
            grid.occupied_cells(),
            [5],
            "0.004 is above half the mean of 0.004 / 16"
        );
    }

    #[test]
    fn a_cell_no_camera_sees_is_never_filled() {
        let mut grid = grid();
        let mut seen = vec![true; 16];
        seen[7] = false;
        grid.set_seen(&seen);
        grid.update(&[7], &[100.0]);
        assert_eq!(grid.values[7], -1.0);
        assert!(!grid.occupied_cells().contains(&7) && !grid.seen_cells().contains(&7));
        grid.set_seen(&[true; 16]);
        assert!(
            grid.occupied_cells().contains(&7),
            "another set of cameras sees it"
        );
    }
}
