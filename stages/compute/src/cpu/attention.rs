//! Attention in tiles: a block of queries meets the keys tile by tile, and no more than one tile of scores exists per
//! thread.

use rayon::prelude::*;

use super::gemm::{Matrix, MatrixMut, Threads, multiply};
use super::lanes;
use super::math::exp;
use super::simd::vectorize;
use crate::attention::Extents;

/// Queries per block.
const QUERIES: usize = 64;
/// Keys per tile.
const KEYS: usize = 512;
/// The backward pass cuts the keys into at most this many ranges, each with its own share of the queries' gradient.
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
        if self.causal { (query + 1).saturating_sub(first).min(keys) } else { keys }
    }

    /// One head's rows `first..first + rows` of one image's tokens.
    fn head<'a>(&self, tokens: &'a [f32], head: usize, first: usize, rows: usize) -> Matrix<'a> {
        Matrix::strided(&tokens[first * self.width() + head * self.depth..], rows, self.depth, self.width())
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
pub fn forward(q: &[f32], k: &[f32], v: &[f32], e: Extents) -> (Vec<f32>, Vec<f32>) {
    let mut out = vec![0.0; q.len()];
    let mut lse = vec![0.0; e.batch * e.queries * e.heads];
    if out.is_empty() {
        return (out, lse);
    }
    let images = out.par_chunks_mut(e.queries * e.width()).zip(lse.par_chunks_mut(e.queries * e.heads));
    images.enumerate().for_each(|(image, (out, lse))| {
        let q = &q[image * e.queries * e.width()..];
        let [k, v] = [k, v].map(|x| &x[image * e.keys * e.width()..]);
        let blocks = out.par_chunks_mut(QUERIES * e.width()).zip(lse.par_chunks_mut(QUERIES * e.heads));
        blocks.enumerate().for_each(|(block, (out, lse))| {
            let mut scores = vec![0.0; QUERIES * KEYS.min(e.keys)];
            for head in 0..e.heads {
                let running = query_block([q, k, v], e, head, block * QUERIES, lse.len() / e.heads, &mut scores);
                finish(&running, e, head, out, lse);
            }
        });
    });
    (out, lse)
}

/// Lets the `rows` queries from `first` on meet all keys.
fn query_block(qkv: [&[f32]; 3], e: Extents, head: usize, first: usize, rows: usize, scores: &mut [f32]) -> Running {
    let [q, k, v] = qkv;
    let queries = e.head(q, head, first, rows);
    let mut running =
        Running { max: [f32::NEG_INFINITY; QUERIES], sum: [0.0; QUERIES], values: vec![0.0; rows * e.depth] };
    for key in (0..e.keys).step_by(KEYS) {
        let keys = KEYS.min(e.keys - key);
        if e.visible(first + rows - 1, key, keys) == 0 {
            break;
        }
        let scores = &mut scores[..rows * keys];
        let tile = e.head(k, head, key, keys).transposed();
        multiply(&mut MatrixMut::new(scores, rows, keys), queries, tile, false, Threads::One);
        for (row, scores) in scores.chunks_mut(keys).enumerate() {
            running.take(row, scores, e.visible(first + row, key, keys), e.scale(), e.depth);
        }
        let mut values = MatrixMut::new(&mut running.values, rows, e.depth);
        multiply(&mut values, Matrix::new(scores, rows, keys), e.head(v, head, key, keys), true, Threads::One);
    }
    running
}

impl Running {
    /// Turns one row of scores into weights relative to the running maximum, and rescales what came before.
    fn take(&mut self, row: usize, scores: &mut [f32], visible: usize, scale: f32, depth: usize) {
        vectorize(
            #[inline(always)]
            || {
                let (seen, hidden) = scores.split_at_mut(visible);
                hidden.fill(0.0);
                let max = self.max[row].max(lanes::max(seen) * scale);
                let sum = lanes::change_and_sum(seen, |score| exp(score * scale - max));
                let shrink = if self.sum[row] > 0.0 { exp(self.max[row] - max) } else { 0.0 };
                for value in &mut self.values[row * depth..(row + 1) * depth] {
                    *value *= shrink;
                }
                self.sum[row] = self.sum[row] * shrink + sum;
                self.max[row] = max;
            },
        );
    }
}

/// Divides by the sums and writes one head of the block.
fn finish(running: &Running, e: Extents, head: usize, out: &mut [f32], lse: &mut [f32]) {
    for (row, values) in running.values.chunks(e.depth).enumerate() {
        let target = &mut out[row * e.width() + head * e.depth..][..e.depth];
        target.iter_mut().zip(values).for_each(|(target, value)| *target = value / running.sum[row]);
        lse[row * e.heads + head] = running.max[row] + running.sum[row].ln();
    }
}

/// One head's gradients from one range of keys, `[tokens, depth]` each.
struct Share {
    dq: Vec<f32>,
    dk: Vec<f32>,
    dv: Vec<f32>,
}

/// The gradients to queries, keys and values, from `[q, k, v]` and `[out, lse, dout]`.
pub fn backward(inputs: [&[f32]; 3], outputs: [&[f32]; 3], e: Extents) -> [Vec<f32>; 3] {
    let ranges = e.keys.div_ceil(2 * KEYS).min(RANGES);
    let range = e.keys.div_ceil(ranges).next_multiple_of(KEYS);
    let ranges = e.keys.div_ceil(range);
    let shares: Vec<Share> = (0..e.batch * e.heads * ranges)
        .into_par_iter()
        .map(|task| {
            let (image, head, first) = (task / ranges / e.heads, task / ranges % e.heads, task % ranges * range);
            key_range(inputs, outputs, e, [image, head], first, range.min(e.keys - first))
        })
        .collect();
    let [mut dq, mut dk, mut dv] = inputs.map(|x| vec![0.0; x.len()]);
    for (task, share) in shares.iter().enumerate() {
        let (image, head, first) = (task / ranges / e.heads, task / ranges % e.heads, task % ranges * range);
        add_head(&mut dq[image * e.queries * e.width()..], &share.dq, e, head, 0);
        add_head(&mut dk[image * e.keys * e.width()..], &share.dk, e, head, first);
        add_head(&mut dv[image * e.keys * e.width()..], &share.dv, e, head, first);
    }
    [dq, dk, dv]
}

/// Adds rows `[tokens, depth]` to one head of one image's tokens, from token `first` on.
fn add_head(tokens: &mut [f32], rows: &[f32], e: Extents, head: usize, first: usize) {
    for (token, row) in tokens[first * e.width()..].chunks_mut(e.width()).zip(rows.chunks(e.depth)) {
        token[head * e.depth..(head + 1) * e.depth].iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
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
    let [q, out, dout] = [inputs[0], outputs[0], outputs[2]].map(|x| &x[image * e.queries * e.width()..]);
    let [k, v] = [inputs[1], inputs[2]].map(|x| &x[image * e.keys * e.width()..]);
    let lse = &outputs[1][image * e.queries * e.heads..];
    let deltas = deltas(out, dout, e, head);
    let [mut dq, mut dk, mut dv] = [e.queries, count, count].map(|rows| vec![0.0; rows * e.depth]);
    let [mut weights, mut slopes] = [(); 2].map(|()| vec![0.0; QUERIES * KEYS.min(count)]);
    for key in (first..first + count).step_by(KEYS) {
        let keys = KEYS.min(first + count - key);
        let (k, v) = (e.head(k, head, key, keys), e.head(v, head, key, keys));
        for query in (0..e.queries).step_by(QUERIES) {
            let rows = QUERIES.min(e.queries - query);
            if e.visible(query + rows - 1, key, keys) == 0 {
                continue;
            }
            let (q, dout) = (e.head(q, head, query, rows), e.head(dout, head, query, rows));
            let (weights, slopes) = (&mut weights[..rows * keys], &mut slopes[..rows * keys]);
            multiply(&mut MatrixMut::new(weights, rows, keys), q, k.transposed(), false, Threads::One);
            multiply(&mut MatrixMut::new(slopes, rows, keys), dout, v.transposed(), false, Threads::One);
            for (row, (weights, slopes)) in weights.chunks_mut(keys).zip(slopes.chunks_mut(keys)).enumerate() {
                let token = query + row;
                let visible = e.visible(token, key, keys);
                score_slopes(weights, slopes, visible, e.scale(), lse[token * e.heads + head], deltas[token]);
            }
            let (weights, slopes) = (Matrix::new(weights, rows, keys), Matrix::new(slopes, rows, keys));
            let at = (key - first) * e.depth;
            let add = |sum: &mut [f32], rows, a, b| {
                multiply(&mut MatrixMut::new(sum, rows, e.depth), a, b, true, Threads::One)
            };
            add(&mut dq[query * e.depth..], rows, slopes, k);
            add(&mut dk[at..], keys, slopes.transposed(), q);
            add(&mut dv[at..], keys, weights.transposed(), dout);
        }
    }
    Share { dq, dk, dv }
}

/// For each query, `out` times `dout` summed over the head: D in FlashAttention's paper.
fn deltas(out: &[f32], dout: &[f32], e: Extents, head: usize) -> Vec<f32> {
    let row = |token: usize| {
        let features = token * e.width() + head * e.depth..token * e.width() + (head + 1) * e.depth;
        out[features.clone()].iter().zip(&dout[features]).map(|(a, b)| a * b).sum()
    };
    (0..e.queries).map(row).collect()
}

/// Turns one row of scores into weights, and the weights' gradient into the scores'.
fn score_slopes(weights: &mut [f32], slopes: &mut [f32], visible: usize, scale: f32, lse: f32, delta: f32) {
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
