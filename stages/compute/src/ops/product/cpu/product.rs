//! Products of matrices: packed panels of the right factor meet tiles of the left one, share by
//! share. It knows how work is cut, not where factors come from.

use super::bf16::{narrow_panel, narrow_tile};
use super::cut::cut;
use super::factor::{DEPTH, Left, Right, TILE};
use super::tile::{COLUMNS, Old, ROWS, multiply_tile};
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::share::Share;
use crate::runtime::format::Precision;

/// Multiplications that one thread does sooner than it wakes others.
const ALONE: usize = 1 << 21;

/// What the sums start from.
#[derive(Clone, Copy)]
pub enum Start<'a> {
    Zero,
    /// One number for each row.
    Rows(&'a [f32]),
    /// One number for each column.
    Columns(&'a [f32]),
}

/// For each of `matrices` results `[rows, columns]`: `start + left right`, summed over `depth`.
pub fn product(
    [matrices, rows, columns]: [usize; 3],
    depth: usize,
    left: &impl Left,
    right: &impl Right,
    start: Start,
    precision: Precision,
) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(matrices * rows * columns);
    let compute = |mut share: Share| {
        let old = begin(&mut share, start);
        add_product(&mut share, left, right, depth, (old, precision));
    };
    let cut = cut([matrices, rows, columns], right.packing());
    // Waking threads takes longer than a small product. The cut is the same, and so are the bits.
    if out.len() * depth <= ALONE {
        cut.for_each_share_alone(&mut out, compute);
    } else {
        cut.for_each_share(&mut out, compute);
    }
    out
}

/// Fills a share with what its sums start from, unless that is nothing.
pub fn begin(share: &mut Share, start: Start) -> Old {
    let rows = share.rows.clone();
    let cut = share.cut;
    for panel in share.panels.clone() {
        let (_, columns) = cut.columns_of(panel);
        let mut block = share.block(0..rows.len(), panel);
        for row in 0..rows.len() {
            match start {
                // Nothing to fill in: the first steps of depth write over whatever is there.
                Start::Zero => return Old::Forget,
                Start::Rows(values) => block.row(row).fill(values[rows.start + row]),
                Start::Columns(values) => block.row(row).copy_from_slice(&values[columns.clone()]),
            }
        }
    }
    Old::Keep
}

/// Writes the product to a share of the result, on the calling thread. A share sums the whole depth:
/// cut between tasks, the order of a sum would be that in which they end.
pub fn add_product(
    share: &mut Share,
    left: &impl Left,
    right: &impl Right,
    depth: usize,
    (old, precision): (Old, Precision),
) {
    let rows = share.rows.clone();
    let cut = share.cut;
    let mut panels = HostBuffer::uninitialised(share.panels.len() * DEPTH.min(depth) * COLUMNS);
    let mut spaces = [[0.0; TILE]; 2];
    for first in (0..depth).step_by(DEPTH) {
        let steps = first..depth.min(first + DEPTH);
        // After the first steps of depth the result holds a part of its sum.
        let old = if first == 0 { old } else { Old::Keep };
        let panels = &mut panels[..share.panels.len() * steps.len() * COLUMNS];
        // Packed once, a panel is read by every tile of rows below.
        for start in steps.clone().step_by(right.grain()) {
            let grain = start..steps.end.min(start + right.grain());
            for (panel, packed) in share
                .panels
                .clone()
                .zip(panels.chunks_mut(steps.len() * COLUMNS))
            {
                let (matrix, columns) = cut.columns_of(panel);
                let packed = &mut packed[(start - first) * COLUMNS..][..grain.len() * COLUMNS];
                right.pack(matrix, columns, grain.clone(), packed);
            }
        }
        panels
            .chunks_mut(steps.len() * COLUMNS)
            .for_each(|packed| narrow_panel(packed, precision));
        for row in (0..rows.len()).step_by(ROWS) {
            let tile = row..rows.len().min(row + ROWS);
            let [space, narrow] = &mut spaces;
            let left = left.tile(
                rows.start + tile.start..rows.start + tile.end,
                steps.clone(),
                space,
            );
            let left = narrow_tile(left, narrow, precision);
            for (panel, packed) in share
                .panels
                .clone()
                .zip(panels.chunks(steps.len() * COLUMNS))
            {
                multiply_tile(
                    &mut share.block(tile.clone(), panel),
                    left,
                    packed,
                    (old, precision),
                );
            }
        }
    }
}
