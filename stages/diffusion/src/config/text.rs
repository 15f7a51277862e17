//! The configuration of a text encoder.

use formats::FileBytes;
use serde::Deserialize;
use serde_json::json;

use super::check::{check_divisors, check_sizes};
use super::parse;
use crate::error::ModelError;

/// Vocabularies are larger than any layer is wide.
const MAX_IDS: usize = 1 << 24;

/// The activation of a text encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TextActivation {
    /// x Phi(x).
    Gelu,
    /// x sigmoid(1.702 x).
    QuickGelu,
}

/// `CLIPTextModel`. Its file carries many fields that have no effect here; they are not looked at.
#[derive(Clone, Debug, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct TextConfig {
    pub vocab_size: usize,
    pub hidden_size: usize,
    pub intermediate_size: usize,
    pub num_hidden_layers: usize,
    pub num_attention_heads: usize,
    pub max_position_embeddings: usize,
    pub hidden_act: TextActivation,
    pub layer_norm_eps: f32,
}

impl Default for TextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 49408,
            hidden_size: 512,
            intermediate_size: 2048,
            num_hidden_layers: 12,
            num_attention_heads: 8,
            max_position_embeddings: 77,
            hidden_act: TextActivation::QuickGelu,
            layer_norm_eps: 1e-5,
        }
    }
}

impl TextConfig {
    /// Reads and checks a `config.json`; the error names the field.
    pub fn read(file: &FileBytes) -> Result<Self, ModelError> {
        let config: Self = parse(file, &json!({ "model_type": "clip_text_model" }), &[])?;
        if !(1..=MAX_IDS).contains(&config.vocab_size) {
            let problem = format!("is {}; it must be from 1 to {MAX_IDS}", config.vocab_size);
            return Err(ModelError::field(file.name(), "vocab_size", problem));
        }
        let sizes = [
            ("hidden_size", config.hidden_size),
            ("intermediate_size", config.intermediate_size),
            ("num_hidden_layers", config.num_hidden_layers),
            ("num_attention_heads", config.num_attention_heads),
            ("max_position_embeddings", config.max_position_embeddings),
        ];
        for (field, size) in sizes {
            check_sizes(file.name(), &[(field, &[size])])?;
        }
        check_divisors(
            file.name(),
            "num_attention_heads",
            &[config.hidden_size],
            |_| config.num_attention_heads,
        )?;
        Ok(config)
    }
}
