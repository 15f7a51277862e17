//! The gradients of attention: tiles of scores are computed again, one range of keys after the
//! other.

use rayon::prelude::*;

use super::head::{KEYS, QUERIES};
use crate::ops::attention::extents::Extents;
use crate::ops::product::cpu::packed::Packed;
use crate::ops::product::cpu::tile::Old;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::math::exp;
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::simd::vectorize;
use crate::runtime::format::Precision;

/// The backward pass cuts the keys into at most this many ranges, each with its own share of the
/// queries' gradient.
// Each holds a gradient to all queries, so few of them; and as many on every machine, since they
// decide the order of sums.
const RANGES: usize = 4;

/// One head's gradients from one range of keys, `[tokens, depth]` each.
struct Gradients {
    dq: Vec<f32>,
    dk: Vec<f32>,
    dv: Vec<f32>,
}

/// The gradients to queries, keys and values, from `[q, k, v]` and `[out, lse, dout]`.
pub fn backward(inputs: [&[f32]; 3], outputs: [&[f32]; 3], e: Extents) -> [HostBuffer; 3] {
    // Two tiles of keys a range at least, where there are so many.
    let ranges = e.keys.div_ceil(2 * KEYS).min(RANGES);
    let range = e.keys.div_ceil(ranges).next_multiple_of(KEYS);
    let ranges = e.keys.div_ceil(range);
    let shares: Vec<Gradients> = (0..e.batch * e.heads * ranges)
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
    // In the order of the ranges, not that in which they end.
    let [mut dq, mut dk, mut dv] = inputs.map(|x| HostBuffer::zeros(x.len()));
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
) -> Gradients {
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
            // q k^T and dout v^T: the keys' and values' tokens are the columns.
            [k, v].map(|x| Packed::new(&x.transposed(), e.depth, keys, Precision::F32));
        let k = Packed::new(&k, keys, e.depth, Precision::F32);
        for query in (0..e.queries).step_by(QUERIES) {
            let rows = QUERIES.min(e.queries - query);
            // Causal: no row of this block sees a key of this tile.
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
            // dq += dS k, dk += dS^T q, dv += P^T dout, with P the weights and dS their scores'
            // slopes.
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
    Gradients { dq, dk, dv }
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
                // No score exceeds the logarithm of the sum, so the exponential is at most 1.
                *weight = exp(*weight * scale - lse);
                // dS = P (dP - D): the softmax's Jacobian, without forming it.
                *slope = *weight * (*slope - delta) * scale;
            }
        },
    );
}
