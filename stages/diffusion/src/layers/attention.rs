//! Multi-head attention of image tokens to themselves or to the text (Vaswani et al. 2017), with adapters.

use compute::Array;
use compute::attention::{Attended, attention, attention_backward};
use compute::elementwise::scaled_sum;

use super::projection::{Projection, ProjectionTape};
use crate::error::ModelError;
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::weights::Scope;

/// Attention with its four projections.
pub(crate) struct Attention {
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

impl Attention {
    /// `text` is the width of the text states for cross-attention, and `None` for self-attention.
    pub fn read(scope: &Scope, channels: usize, text: Option<usize>, heads: usize) -> Result<Self, ModelError> {
        let source = text.unwrap_or(channels);
        Ok(Self {
            query: Projection::without_bias(&scope.at("to_q"), channels, channels)?,
            key: Projection::without_bias(&scope.at("to_k"), source, channels)?,
            value: Projection::without_bias(&scope.at("to_v"), source, channels)?,
            out: Projection::read(&scope.at("to_out.0"), channels, channels)?,
            heads,
            cross: text.is_some(),
        })
    }

    pub fn sites(&self) -> [&AdapterSite; 4] {
        [self.query.site(), self.key.site(), self.value.site(), self.out.site()]
    }

    /// Tokens `x [N, T, C]`, text `[N, S, D]`.
    pub fn forward(&self, x: &Array, text: &Array, lora: Option<&LoraNetwork>) -> (Array, AttentionTape) {
        let source = if self.cross { text } else { x };
        let (q, query) = self.query.forward(x, lora);
        let (k, key) = self.key.forward(source, lora);
        let (v, value) = self.value.forward(source, lora);
        let attended = attention(&q, &k, &v, self.heads, false);
        let (y, out) = self.out.forward(&attended.out, lora);
        (y, AttentionTape { projections: [query, key, value, out], qkv: [q, k, v], attended })
    }

    /// The gradient by `x`; the text is frozen and gets none.
    pub fn backward(
        &self,
        tape: &AttentionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Array {
        let ([query, key, value, out], [q, k, v]) = (&tape.projections, &tape.qkv);
        let attended = self.out.backward(out, dy, lora, gradients);
        let [dq, dk, dv] = attention_backward(q, k, v, &tape.attended, self.heads, false, &attended);
        let dx = self.query.backward(query, &dq, lora, gradients);
        if self.cross {
            self.key.backward_adapter(key, &dk, lora, gradients);
            self.value.backward_adapter(value, &dv, lora, gradients);
            return dx;
        }
        let through_key = self.key.backward(key, &dk, lora, gradients);
        let through_value = self.value.backward(value, &dv, lora, gradients);
        scaled_sum(&[(1.0, &dx), (1.0, &through_key), (1.0, &through_value)])
    }
}
