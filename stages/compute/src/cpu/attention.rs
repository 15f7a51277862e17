//! Attention in tiles: a block of queries meets the keys tile by tile, and no more than one tile of
//! scores exists per thread.

use rayon::prelude::*;

use super::buffer::Buffer;
use super::lanes;
use super::math::exp;
use super::matrix::{Cut, Matrix};
use super::product::Packed;
use super::simd::vectorize;
use super::tile::Old;
use crate::attention::Extents;
use crate::weight::Precision;

/// Queries per block: its scores are one tile.
const QUERIES: usize = 48;
/// Blocks of queries per task, which meet the same packed keys.
const BLOCKS: usize = 8;
/// Keys per tile.
const KEYS: usize = 512;
/// The backward pass cuts the keys into at most this many ranges, each with its own share of the
/// queries' gradient.
const RANGES: usize = 4;

impl Extents {
    fn width(&self) -> usize {
        self.heads * self.depth
    }

    fn scale(&self) -> f32 {
        1.0 / (self.depth as f32).sqrt()
    }

    /// How many of the `keys` from `first` on the query may see.
    fn visible(&self, query: usize, first: usize, keys: usize) -> usize {
        if self.causal {
            (query + 1).saturating_sub(first).min(keys)
        } else {
            keys
        }
    }

    /// One head's rows `first..first + rows` of one image's tokens.
    fn head<'a>(&self, tokens: &'a [f32], head: usize, first: usize, rows: usize) -> Matrix<'a> {
        Matrix::strided(
            &tokens[first * self.width() + head * self.depth..],
            rows,
            self.depth,
            self.width(),
        )
    }
}

/// What one block of queries has gathered so far.
struct Running {
    max: [f32; QUERIES],
    sum: [f32; QUERIES],
    /// The attended values times `sum`, `[rows, depth]`.
    values: Vec<f32>,
}

/// The output and the logarithms of the sums of exponentials.
pub fn forward(q: &[f32], k: &[f32], v: &[f32], e: Extents) -> (Buffer, Buffer) {
    let mut out = Buffer::stale(q.len());
    let mut lse = Buffer::stale(e.batch * e.queries * e.heads);
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
    let mut scores = vec![0.0; QUERIES * KEYS.min(e.keys)];
    for key in (0..e.keys).step_by(KEYS) {
        let keys = KEYS.min(e.keys - key);
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
                let shrink = if self.sum[row] > 0.0 {
                    exp(self.max[row] - max)
                } else {
                    0.0
                };
                for value in &mut self.values[row * depth..(row + 1) * depth] {
                    *value *= shrink;
                }
                self.sum[row] = self.sum[row] * shrink + sum;
                self.max[row] = max;
            },
        );
    }
}

/// One head's gradients from one range of keys, `[tokens, depth]` each.
struct Share {
    dq: Vec<f32>,
    dk: Vec<f32>,
    dv: Vec<f32>,
}

/// The gradients to queries, keys and values, from `[q, k, v]` and `[out, lse, dout]`.
pub fn backward(inputs: [&[f32]; 3], outputs: [&[f32]; 3], e: Extents) -> [Buffer; 3] {
    let ranges = e.keys.div_ceil(2 * KEYS).min(RANGES);
    let range = e.keys.div_ceil(ranges).next_multiple_of(KEYS);
    let ranges = e.keys.div_ceil(range);
    let shares: Vec<Share> = (0..e.batch * e.heads * ranges)
        .into_par_iter()
        .map(|task| {
            let image = task / ranges / e.heads;
            let head = task / ranges % e.heads;
            let first = task % ranges * range;
            key_range(
                inputs,
                outputs,
                e,
                [image, head],
                first,
                range.min(e.keys - first),
            )
        })
        .collect();
    let [mut dq, mut dk, mut dv] = inputs.map(|x| Buffer::zeros(x.len()));
    for (task, share) in shares.iter().enumerate() {
        let image = task / ranges / e.heads;
        let head = task / ranges % e.heads;
        let first = task % ranges * range;
        add_head(
            &mut dq[image * e.queries * e.width()..],
            &share.dq,
            e,
            head,
            0,
        );
        add_head(
            &mut dk[image * e.keys * e.width()..],
            &share.dk,
            e,
            head,
            first,
        );
        add_head(
            &mut dv[image * e.keys * e.width()..],
            &share.dv,
            e,
            head,
            first,
        );
    }
    [dq, dk, dv]
}

/// Adds rows `[tokens, depth]` to one head of one image's tokens, from token `first` on.
fn add_head(tokens: &mut [f32], rows: &[f32], e: Extents, head: usize, first: usize) {
    for (token, row) in tokens[first * e.width()..]
        .chunks_mut(e.width())
        .zip(rows.chunks(e.depth))
    {
        token[head * e.depth..(head + 1) * e.depth]
            .iter_mut()
            .zip(row)
            .for_each(|(sum, value)| *sum += value);
    }
}

/// The gradients that flow through the `count` keys from `first` on, for one head of one image.
fn key_range(
    inputs: [&[f32]; 3],
    outputs: [&[f32]; 3],
    e: Extents,
    [image, head]: [usize; 2],
    first: usize,
    count: usize,
) -> Share {
    let [q, out, dout] =
        [inputs[0], outputs[0], outputs[2]].map(|x| &x[image * e.queries * e.width()..]);
    let [k, v] = [inputs[1], inputs[2]].map(|x| &x[image * e.keys * e.width()..]);
    let lse = &outputs[1][image * e.queries * e.heads..];
    let deltas = deltas(out, dout, e, head);
    let [mut dq, mut dk, mut dv] = [e.queries, count, count].map(|rows| vec![0.0; rows * e.depth]);
    let [mut weights, mut slopes] = [(); 2].map(|()| vec![0.0; QUERIES * KEYS.min(count)]);
    for key in (first..first + count).step_by(KEYS) {
        let keys = KEYS.min(first + count - key);
        let k = e.head(k, head, key, keys);
        let v = e.head(v, head, key, keys);
        let [turned_k, turned_v] =
            [k, v].map(|x| Packed::new(&x.transposed(), e.depth, keys, Precision::F32));
        let k = Packed::new(&k, keys, e.depth, Precision::F32);
        for query in (0..e.queries).step_by(QUERIES) {
            let rows = QUERIES.min(e.queries - query);
            if e.visible(query + rows - 1, key, keys) == 0 {
                continue;
            }
            let q = e.head(q, head, query, rows);
            let dout = e.head(dout, head, query, rows);
            let weights = &mut weights[..rows * keys];
            let slopes = &mut slopes[..rows * keys];
            turned_k.multiply(weights, rows, &q, Old::Forget);
            turned_v.multiply(slopes, rows, &dout, Old::Forget);
            for (row, (weights, slopes)) in weights
                .chunks_mut(keys)
                .zip(slopes.chunks_mut(keys))
                .enumerate()
            {
                let token = query + row;
                let visible = e.visible(token, key, keys);
                score_slopes(
                    weights,
                    slopes,
                    visible,
                    e.scale(),
                    lse[token * e.heads + head],
                    deltas[token],
                );
            }
            let weights = Matrix::new(weights, rows, keys);
            let slopes = Matrix::new(slopes, rows, keys);
            let at = (key - first) * e.depth;
            k.multiply(
                &mut dq[query * e.depth..][..rows * e.depth],
                rows,
                &slopes,
                Old::Keep,
            );
            let [q, dout] = [q, dout].map(|x| Packed::new(&x, rows, e.depth, Precision::F32));
            q.multiply(
                &mut dk[at..][..keys * e.depth],
                keys,
                &slopes.transposed(),
                Old::Keep,
            );
            dout.multiply(
                &mut dv[at..][..keys * e.depth],
                keys,
                &weights.transposed(),
                Old::Keep,
            );
        }
    }
    Share { dq, dk, dv }
}

/// For each query, `out` times `dout` summed over the head: D in FlashAttention's paper.
fn deltas(out: &[f32], dout: &[f32], e: Extents, head: usize) -> Vec<f32> {
    let row = |token: usize| {
        let features = token * e.width() + head * e.depth..token * e.width() + (head + 1) * e.depth;
        out[features.clone()]
            .iter()
            .zip(&dout[features])
            .map(|(a, b)| a * b)
            .sum()
    };
    (0..e.queries).map(row).collect()
}

/// Turns one row of scores into weights, and the weights' gradient into the scores'.
fn score_slopes(
    weights: &mut [f32],
    slopes: &mut [f32],
    visible: usize,
    scale: f32,
    lse: f32,
    delta: f32,
) {
    vectorize(
        #[inline(always)]
        || {
            weights[visible..].fill(0.0);
            slopes[visible..].fill(0.0);
            for (weight, slope) in weights[..visible].iter_mut().zip(&mut slopes[..visible]) {
                *weight = exp(*weight * scale - lse);
                *slope = *weight * (*slope - delta) * scale;
            }
        },
    );
}
