//! `CLIPTextModel` of transformers: token ids to the states that the UNet attends to. Inference
//! only.

use compute::activation::{gelu, quick_gelu};
use compute::attention::attention;
use compute::elementwise::add;
use compute::shape::gather_rows;
use compute::{Array, Device, Weight};

use crate::config::{TextActivation, TextConfig};
use crate::error::ModelError;
use crate::layers::{LayerNorm, Linear};
use crate::network::Network;
use crate::source::ModelSource;
use crate::weights::{Scope, Weights};

/// CLIP's text encoder, from token ids to hidden states.
pub struct TextEncoder {
    config: TextConfig,
    tokens: Weight,
    positions: Array,
    layers: Vec<Layer>,
    norm: LayerNorm,
}

/// A transformer layer in which a token sees those before it and itself.
struct Layer {
    norm1: LayerNorm,
    query: Linear,
    key: Linear,
    value: Linear,
    out: Linear,
    norm2: LayerNorm,
    expand: Linear,
    contract: Linear,
    heads: usize,
    activation: TextActivation,
}

impl TextEncoder {
    /// Reads the text encoder of `source` onto `device`. The error names the file, and the field or
    /// tensor in it.
    pub fn load(source: &ModelSource, device: &Device) -> Result<Self, ModelError> {
        let config = TextConfig::read(&source.file("text_encoder/config.json")?)?;
        Self::read(config, source.weights(Network::TextEncoder, device)?)
    }

    /// Reads the encoder. Fails if the file does not hold exactly the tensors that the
    /// configuration asks for.
    fn read(config: TextConfig, weights: Weights) -> Result<Self, ModelError> {
        let root = weights.root();
        let nested = root.at("text_model");
        // Some files lack the name that `CLIPTextModel` puts before all others.
        let root = if nested.has("final_layer_norm.weight") {
            nested
        } else {
            root
        };
        let width = config.hidden_size;
        let eps = config.layer_norm_eps;
        let layer = |i| Layer::read(&root.at(format!("encoder.layers.{i}")), &config);
        let encoder = Self {
            tokens: root.weight(
                "embeddings.token_embedding.weight",
                &[config.vocab_size, width],
            )?,
            positions: root.tensor(
                "embeddings.position_embedding.weight",
                &[config.max_position_embeddings, width],
            )?,
            layers: (0..config.num_hidden_layers)
                .map(layer)
                .collect::<Result<_, _>>()?,
            norm: LayerNorm::read(&root.at("final_layer_norm"), width, eps)?,
            config,
        };
        // A list of 0, 1, 2.. that older versions of transformers saved, and CLIP's way to the
        // space of images: neither has a say in the states.
        weights.finish(&["position_ids", "text_projection.weight"])?;
        Ok(encoder)
    }

    /// What its `config.json` says.
    pub fn config(&self) -> &TextConfig {
        &self.config
    }

    /// The last hidden states `[N, T, D]` of N texts of T ids each.
    pub fn forward(&self, texts: &[Vec<u32>]) -> Array {
        let length = texts.first().map_or(0, Vec::len);
        // [N T] rows of the table, one text behind the other, as the ids are.
        let positions: Vec<u32> = texts.iter().flat_map(|_| 0..length as u32).collect();
        let x = add(
            &gather_rows(&self.tokens, &texts.concat()),
            &gather_rows(&self.positions, &positions),
        );
        let x = x.reshape(&[texts.len(), length, self.config.hidden_size]);
        self.norm
            .forward(&self.layers.iter().fold(x, |x, layer| layer.forward(&x)))
    }
}

impl Layer {
    fn read(scope: &Scope, config: &TextConfig) -> Result<Self, ModelError> {
        let width = config.hidden_size;
        let wide = config.intermediate_size;
        let eps = config.layer_norm_eps;
        let projection = |name: &str| Linear::read(&scope.at("self_attn").at(name), width, width);
        Ok(Self {
            norm1: LayerNorm::read(&scope.at("layer_norm1"), width, eps)?,
            query: projection("q_proj")?,
            key: projection("k_proj")?,
            value: projection("v_proj")?,
            out: projection("out_proj")?,
            norm2: LayerNorm::read(&scope.at("layer_norm2"), width, eps)?,
            expand: Linear::read(&scope.at("mlp.fc1"), width, wide)?,
            contract: Linear::read(&scope.at("mlp.fc2"), wide, width)?,
            heads: config.num_attention_heads,
            activation: config.hidden_act,
        })
    }

    fn forward(&self, x: &Array) -> Array {
        let normalised = self.norm1.forward(x);
        let [q, k, v] =
            [&self.query, &self.key, &self.value].map(|layer| layer.forward(&normalised));
        let x = add(
            x,
            &self
                .out
                // Causal, as CLIP was trained: a token sees none behind it.
                .forward(&attention(&q, &k, &v, self.heads, true).out),
        );
        let expanded = self.expand.forward(&self.norm2.forward(&x));
        let activated = match self.activation {
            TextActivation::Gelu => gelu(&expanded),
            TextActivation::QuickGelu => quick_gelu(&expanded),
        };
        add(&x, &self.contract.forward(&activated))
    }
}
