//! A text as the frozen attentions see it. Knows no tokens.

use std::collections::BTreeMap;

use compute::Array;

/// Text states and what every attention to the text makes of them: computed once for a prompt, used
/// in every step.
#[derive(Clone)]
pub struct TextContext {
    /// The text states `[P, S, D]`; one text stands for all samples.
    pub(crate) states: Array,
    /// Keys and values `[P, S, C]` of the frozen weights, by the attention's name.
    pub(crate) projected: BTreeMap<String, [Array; 2]>,
}
