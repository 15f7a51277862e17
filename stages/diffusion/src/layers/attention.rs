//! Multi-head attention of image tokens to themselves or to the text (Vaswani et al. 2017), with
//! adapters.

use std::collections::BTreeMap;

use compute::Array;
use compute::attention::{Attended, attention, attention_backward};
use compute::elementwise::scaled_sum;
use compute::shape::{concat, slice};

use super::projection::{Projection, ProjectionTape};
use crate::error::ModelError;
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::unet::TextContext;
use crate::weights::Scope;

/// Attention with its four projections.
pub(crate) struct Attention {
    name: String,
    query: Projection,
    key: Projection,
    value: Projection,
    out: Projection,
    heads: usize,
    /// Whether keys and values come from the text.
    cross: bool,
}

/// What the backward pass needs.
pub(crate) struct AttentionTape {
    projections: [ProjectionTape; 4],
    qkv: [Array; 3],
    attended: Attended,
}

impl AttentionTape {
    /// The bytes that it holds.
    pub fn bytes(&self) -> usize {
        let [query, key, value, out] = &self.projections;
        let inputs: usize = [query, key, value, out]
            .iter()
            .map(|tape| tape.bytes())
            .sum();
        // `attended.out` is the last projection's input and counted there.
        inputs + 4 * (self.qkv.iter().map(Array::len).sum::<usize>() + self.attended.lse.len())
    }
}

impl Attention {
    /// `text` is the width of the text states for cross-attention, and `None` for self-attention.
    pub fn read(
        scope: &Scope,
        channels: usize,
        text: Option<usize>,
        heads: usize,
    ) -> Result<Self, ModelError> {
        let source = text.unwrap_or(channels);
        Ok(Self {
            name: scope.path().to_owned(),
            // Diffusers' attentions have a bias in the last projection alone.
            query: Projection::without_bias(&scope.at("to_q"), channels, channels)?,
            key: Projection::without_bias(&scope.at("to_k"), source, channels)?,
            value: Projection::without_bias(&scope.at("to_v"), source, channels)?,
            out: Projection::read(&scope.at("to_out.0"), channels, channels)?,
            heads,
            cross: text.is_some(),
        })
    }

    pub fn sites(&self) -> [&AdapterSite; 4] {
        [
            self.query.site(),
            self.key.site(),
            self.value.site(),
            self.out.site(),
        ]
    }

    /// Puts the frozen keys and values of the text states `[P, S, D]` into `projected`.
    pub fn project_text(&self, states: &Array, projected: &mut BTreeMap<String, [Array; 2]>) {
        if self.cross {
            projected.insert(
                self.name.clone(),
                [self.key.frozen(states), self.value.frozen(states)],
            );
        }
    }

    /// Tokens `x [N, T, C]`.
    pub fn forward(
        &self,
        x: &Array,
        text: &TextContext,
        lora: Option<&LoraNetwork>,
    ) -> (Array, AttentionTape) {
        let (q, query) = self.query.forward(x, lora);
        // The frozen part of a prompt's keys and values does not change between steps; only the
        // adapters' part is computed anew.
        let [(k, key), (v, value)] = match text.projected.get(&self.name) {
            Some([k, v]) => [
                self.key.adapt(&text.states, k, lora),
                self.value.adapt(&text.states, v, lora),
            ],
            // Only attentions to the text are in `projected`; the others look at the image.
            None => [self.key.forward(x, lora), self.value.forward(x, lora)],
        };
        // [P, S, C] with P = 1 or N; the operator wants as many keys as queries have samples.
        let [k, v] = [k, v].map(|projected| for_all(&projected, x.shape()[0]));
        let attended = attention(&q, &k, &v, self.heads, false);
        let (y, out) = self.out.forward(&attended.out, lora);
        (
            y,
            AttentionTape {
                // Scores are not kept: the backward pass computes them again, a tile at a time.
                projections: [query, key, value, out],
                qkv: [q, k, v],
                attended,
            },
        )
    }

    /// The gradient by `x`; the text is frozen and gets none.
    pub fn backward(
        &self,
        tape: &AttentionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Array {
        let [query, key, value, out] = &tape.projections;
        let [q, k, v] = &tape.qkv;
        let attended = self.out.backward(out, dy, lora, gradients);
        let [dq, dk, dv] =
            attention_backward(q, k, v, &tape.attended, self.heads, false, &attended);
        let dx = self.query.backward(query, &dq, lora, gradients);
        // The text states are frozen, so nothing flows back to them; keys' and values' adapters
        // still learn.
        if self.cross {
            self.key
                .backward_adapter(key, &over_all(&dk, key.samples()), lora, gradients);
            self.value
                .backward_adapter(value, &over_all(&dv, value.samples()), lora, gradients);
            return dx;
        }
        let through_key = self.key.backward(key, &dk, lora, gradients);
        let through_value = self.value.backward(value, &dv, lora, gradients);
        // x went into queries, keys and values: their gradients add up.
        scaled_sum(&[(1.0, &dx), (1.0, &through_key), (1.0, &through_value)])
    }
}

/// One text for each of `n` samples.
fn for_all(text: &Array, n: usize) -> Array {
    if text.shape()[0] == n {
        text.clone()
    } else {
        concat(&vec![text; n], 0)
    }
}

/// The gradient of [`for_all`] to `texts` texts: where one stood for all samples, their sum.
fn over_all(d: &Array, texts: usize) -> Array {
    let n = d.shape()[0];
    if texts == n {
        return d.clone();
    }
    // One after the other in the samples' order, so that the sum has the same bits every time.
    let parts: Vec<Array> = (0..n).map(|i| slice(d, 0, i, 1)).collect();
    scaled_sum(&parts.iter().map(|part| (1.0, part)).collect::<Vec<_>>())
}
