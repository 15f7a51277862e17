//! A right factor that several left factors meet. It knows no threads.

use super::bf16::{narrow_panel, narrow_tile};
use super::factor::{DEPTH, Left, Right, TILE};
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::matrix::MatrixMut;
use crate::runtime::format::Precision;

/// A right factor packed once, to meet several left factors.
pub struct Packed {
    /// For each range of [`DEPTH`] steps, its panels.
    values: HostBuffer,
    depth: usize,
    columns: usize,
    precision: Precision,
}

impl Packed {
    pub fn new(right: &impl Right, depth: usize, columns: usize, precision: Precision) -> Packed {
        let panels = columns.div_ceil(COLUMNS);
        let mut values = HostBuffer::uninitialised(depth * panels * COLUMNS);
        for (i, values) in values.chunks_mut(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..depth.min((i + 1) * DEPTH);
            for (panel, packed) in values.chunks_mut(steps.len() * COLUMNS).enumerate() {
                // [steps, COLUMNS], panel after panel, as the tiles read it.
                let range = panel * COLUMNS..columns.min((panel + 1) * COLUMNS);
                right.pack(0, range, steps.clone(), packed);
                narrow_panel(packed, precision);
            }
        }
        Packed {
            values,
            depth,
            columns,
            precision,
        }
    }

    /// Writes `left` times this factor to `out`, a contiguous matrix of `rows` rows, on the calling
    /// thread.
    pub fn multiply(&self, out: &mut [f32], rows: usize, left: &impl Left, old: Old) {
        let panels = self.columns.div_ceil(COLUMNS);
        let mut out = MatrixMut::new(out, rows, self.columns);
        let mut spaces = [[0.0; TILE]; 2];
        for (i, values) in self.values.chunks(DEPTH * panels * COLUMNS).enumerate() {
            let steps = i * DEPTH..self.depth.min((i + 1) * DEPTH);
            // Behind the first steps of depth the result holds a part of its sum.
            let old = if i == 0 { old } else { Old::Keep };
            for row in (0..rows).step_by(ROWS) {
                let tile = row..rows.min(row + ROWS);
                let [space, narrow] = &mut spaces;
                let left = narrow_tile(
                    left.tile(tile.clone(), steps.clone(), space),
                    narrow,
                    self.precision,
                );
                for (panel, packed) in values.chunks(steps.len() * COLUMNS).enumerate() {
                    let columns = panel * COLUMNS..self.columns.min((panel + 1) * COLUMNS);
                    multiply_tile(
                        &mut out.block(tile.clone(), columns),
                        left,
                        packed,
                        (old, self.precision),
                    );
                }
            }
        }
    }
}
