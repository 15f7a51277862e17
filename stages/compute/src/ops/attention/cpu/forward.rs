//! The attended values: what a block of queries has gathered is rescaled as larger scores are met,
//! so that no score is needed twice.

use super::head::{BLOCKS, KEYS, QUERIES};
use crate::ops::attention::extents::Extents;
use crate::ops::product::cpu::packed::Packed;
use crate::ops::product::cpu::tile::Old;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::lanes;
use crate::runtime::cpu::math::exp;
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::share::Cut;
use crate::runtime::cpu::simd::vectorize;
use crate::runtime::format::Precision;

/// What one block of queries has gathered so far.
struct Running {
    max: [f32; QUERIES],
    sum: [f32; QUERIES],
    /// The attended values times `sum`, `[rows, depth]`.
    values: Vec<f32>,
}

/// The output and the logarithms of the sums of exponentials.
pub fn forward(q: &[f32], k: &[f32], v: &[f32], e: Extents) -> (HostBuffer, HostBuffer) {
    let mut out = HostBuffer::uninitialised(q.len());
    let mut lse = HostBuffer::uninitialised(e.batch * e.queries * e.heads);
    // A panel is one head.
    let heads = Cut {
        matrices: e.batch,
        rows: e.queries,
        columns: e.width(),
        panel: e.depth,
        share_rows: BLOCKS * QUERIES,
        share_panels: 1,
    };
    let sums = heads.map_shares(&mut out, |mut share| {
        let image = share.panels.start / e.heads;
        let head = share.panels.start % e.heads;
        let first = share.rows.start;
        let [k, v] = [k, v].map(|x| &x[image * e.keys * e.width()..]);
        let queries = e.head(
            &q[image * e.queries * e.width()..],
            head,
            first,
            share.rows.len(),
        );
        let blocks = gather([k, v], queries, e, head, first);
        let mut lse = Vec::with_capacity(share.rows.len());
        for (i, block) in blocks.iter().enumerate() {
            for (row, values) in block.values.chunks(e.depth).enumerate() {
                let place = i * QUERIES + row;
                let mut out = share.block(place..place + 1, share.panels.start);
                out.row(0)
                    .iter_mut()
                    .zip(values)
                    // Divided once at the end, not at every tile.
                    .for_each(|(out, value)| *out = value / block.sum[row]);
                lse.push(block.max[row] + block.sum[row].ln());
            }
        }
        ((image * e.queries + first) * e.heads + head, lse)
    });
    for (place, sums) in sums {
        lse[place..]
            .iter_mut()
            .step_by(e.heads)
            .zip(sums)
            .for_each(|(lse, sum)| *lse = sum);
    }
    (out, lse)
}

/// Lets the `queries`, whose first is number `first`, meet all keys.
fn gather(
    [k, v]: [&[f32]; 2],
    queries: Matrix,
    e: Extents,
    head: usize,
    first: usize,
) -> Vec<Running> {
    let starts = (0..queries.rows).step_by(QUERIES);
    let blocks = starts.map(|start| start..queries.rows.min(start + QUERIES));
    let mut running: Vec<Running> = blocks
        .clone()
        .map(|rows| Running::new(rows.len(), e.depth))
        .collect();
    // One tile of scores, [QUERIES, KEYS], is all that exists of them.
    let mut scores = vec![0.0; QUERIES * KEYS.min(e.keys)];
    for key in (0..e.keys).step_by(KEYS) {
        let keys = KEYS.min(e.keys - key);
        // Keys come in order, so the tiles behind this one are hidden as well.
        if e.visible(first + queries.rows - 1, key, keys) == 0 {
            break;
        }
        let tile = Packed::new(
            &e.head(k, head, key, keys).transposed(),
            e.depth,
            keys,
            Precision::F32,
        );
        let values = Packed::new(&e.head(v, head, key, keys), keys, e.depth, Precision::F32);
        for (rows, running) in blocks.clone().zip(&mut running) {
            if e.visible(first + rows.end - 1, key, keys) == 0 {
                continue;
            }
            let scores = &mut scores[..rows.len() * keys];
            tile.multiply(scores, rows.len(), &queries.rows(rows.clone()), Old::Forget);
            for (i, scores) in scores.chunks_mut(keys).enumerate() {
                running.take(
                    i,
                    scores,
                    e.visible(first + rows.start + i, key, keys),
                    e.scale(),
                    e.depth,
                );
            }
            values.multiply(
                &mut running.values,
                rows.len(),
                &Matrix::new(scores, rows.len(), keys),
                Old::Keep,
            );
        }
    }
    running
}

impl Running {
    fn new(rows: usize, depth: usize) -> Running {
        Running {
            max: [f32::NEG_INFINITY; QUERIES],
            sum: [0.0; QUERIES],
            values: vec![0.0; rows * depth],
        }
    }

    /// Turns one row of scores into weights relative to the running maximum, and rescales what came
    /// before.
    fn take(&mut self, row: usize, scores: &mut [f32], visible: usize, scale: f32, depth: usize) {
        vectorize(
            #[inline(always)]
            || {
                let (seen, hidden) = scores.split_at_mut(visible);
                hidden.fill(0.0);
                let max = self.max[row].max(lanes::max(seen) * scale);
                let sum = lanes::change_and_sum(seen, |score| exp(score * scale - max));
                // Before anything was seen, both maxima may be minus infinity, whose difference is no
                // number.
                let shrink = if self.sum[row] > 0.0 {
                    exp(self.max[row] - max)
                } else {
                    0.0
                };
                // What was gathered is relative to the old maximum.
                for value in &mut self.values[row * depth..(row + 1) * depth] {
                    *value *= shrink;
                }
                self.sum[row] = self.sum[row] * shrink + sum;
                self.max[row] = max;
            },
        );
    }
}
