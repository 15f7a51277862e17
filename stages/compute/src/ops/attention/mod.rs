//! Multi-head scaled dot-product attention and its gradients, in memory linear in the number of
//! tokens. It knows projected queries, keys and values, not where they come from.

mod cpu;
mod extents;
mod gpu;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, same_shape};
use crate::runtime::device::Backend;

use extents::Extents;

/// What attention gives, with what its backward pass needs.
#[derive(Clone, Debug)]
pub struct Attended {
    /// The attended values `[N, T, heads * d]`.
    pub out: Array,
    /// For each query, the logarithm of the sum of the exponentials of its scaled scores, `[N, T,
    /// heads]`.
    pub lse: Array,
}

fn extents(op: &str, q: &Array, k: &Array, v: &Array, heads: usize, causal: bool) -> Extents {
    let (&[batch, queries, width], &[key_batch, keys, key_width]) = (q.shape(), k.shape()) else {
        panic!(
            "{op}: expected [N, T, heads * d], got {:?} and {:?}",
            q.shape(),
            k.shape()
        )
    };
    same_shape(op, k, v);
    assert!(
        batch == key_batch && width == key_width,
        "{op}: queries {:?}, keys {:?}",
        q.shape(),
        k.shape()
    );
    assert!(
        heads > 0 && width % heads == 0,
        "{op}: {width} features do not divide into {heads} heads"
    );
    // A softmax over no keys has no value.
    assert!(
        keys > 0 && (!causal || queries == keys),
        "{op}: {queries} queries, {keys} keys, causal: {causal}"
    );
    Extents {
        batch,
        queries,
        keys,
        heads,
        depth: width / heads,
        causal,
    }
}

/// `softmax(q k^T / sqrt(d)) v` for each head; queries `[N, T, heads * d]`, keys and values `[N, S,
/// heads * d]`. If `causal`, query `t` sees the keys up to and including `t` only. Vaswani et al.
/// 2017, equation 1; tiled as in Dao 2023 (FlashAttention-2), algorithm 1.
pub fn attention(q: &Array, k: &Array, v: &Array, heads: usize, causal: bool) -> Attended {
    let extents = extents("attention", q, k, v, heads, causal);
    match q.device().backend() {
        Backend::Cpu => {
            let (out, lse) = cpu::forward::forward(q.host(), k.host(), v.host(), extents);
            let lse = Array::on_cpu(&[extents.batch, extents.queries, heads], lse);
            Attended {
                out: Array::on_cpu(q.shape(), out),
                lse,
            }
        }
        Backend::Gpu(gpu) => {
            let [out, lse] = gpu::forward(gpu, [q, k, v].map(Array::device_buffer), extents);
            let lse = Array::on_gpu(gpu, &[extents.batch, extents.queries, heads], lse);
            Attended {
                out: Array::on_gpu(gpu, q.shape(), out),
                lse,
            }
        }
    }
}

/// The gradients of [`attention`] to its queries, keys and values, given the gradient `dout` to its
/// output. The scores are computed again, tile by tile. Dao 2023, algorithm 2.
pub fn attention_backward(
    q: &Array,
    k: &Array,
    v: &Array,
    attended: &Attended,
    heads: usize,
    causal: bool,
    dout: &Array,
) -> [Array; 3] {
    let extents = extents("attention_backward", q, k, v, heads, causal);
    same_shape("attention_backward", q, dout);
    same_shape("attention_backward", q, &attended.out);
    match q.device().backend() {
        Backend::Cpu => {
            let inputs = [q.host(), k.host(), v.host()];
            let outputs = [attended.out.host(), attended.lse.host(), dout.host()];
            let [dq, dk, dv] = cpu::backward::backward(inputs, outputs, extents);
            [
                Array::on_cpu(q.shape(), dq),
                Array::on_cpu(k.shape(), dk),
                Array::on_cpu(v.shape(), dv),
            ]
        }
        Backend::Gpu(gpu) => {
            let inputs = [q, k, v].map(Array::device_buffer);
            let outputs = [&attended.out, &attended.lse, dout].map(Array::device_buffer);
            let [dq, dk, dv] = gpu::backward(gpu, inputs, outputs, extents);
            [(q, dq), (k, dk), (v, dv)].map(|(x, values)| Array::on_gpu(gpu, x.shape(), values))
        }
    }
}
