//! The networks' configurations as diffusers and transformers write them, with the same defaults.
//!
//! An option that the networks here do not have is refused by name. Knows no weights and no arithmetic.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::error::ModelError;
use crate::source::ModelFile;

/// Sizes beyond this are taken for a damaged file.
const MAX_SIZE: usize = 1 << 16;

/// One value for all blocks, or one for each, from the first down block on.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum PerBlock<T> {
    /// For all blocks.
    Same(T),
    /// One for each block.
    Each(Vec<T>),
}

impl<T: Copy> PerBlock<T> {
    /// The value of block `index`.
    pub fn of(&self, index: usize) -> T {
        match self {
            Self::Same(value) => *value,
            Self::Each(values) => values[index],
        }
    }

    fn all(&self) -> &[T] {
        match self {
            Self::Same(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }
}

/// The kinds of blocks of a UNet, down or up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum UnetBlock {
    /// ResNet layers only.
    #[serde(rename = "DownBlock2D", alias = "UpBlock2D")]
    Plain,
    /// ResNet layers, each followed by a transformer.
    #[serde(rename = "CrossAttnDownBlock2D", alias = "CrossAttnUpBlock2D")]
    CrossAttention,
}

/// `UNet2DConditionModel`.
#[derive(Clone, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs)]
pub struct UnetConfig {
    pub in_channels: usize,
    pub out_channels: usize,
    pub flip_sin_to_cos: bool,
    pub freq_shift: f32,
    pub down_block_types: Vec<UnetBlock>,
    pub up_block_types: Vec<UnetBlock>,
    /// Whether both attentions of a transformer look at the text, in place of the image and the text. The mid block's never do.
    pub only_cross_attention: PerBlock<bool>,
    pub block_out_channels: Vec<usize>,
    pub layers_per_block: PerBlock<usize>,
    pub norm_num_groups: usize,
    pub norm_eps: f32,
    /// The width of the text states.
    pub cross_attention_dim: PerBlock<usize>,
    pub transformer_layers_per_block: PerBlock<usize>,
    /// The number of heads, whatever its name says: diffusers keeps it for old files.
    pub attention_head_dim: PerBlock<usize>,
    pub use_linear_projection: bool,
    pub num_class_embeds: Option<usize>,
}

impl Default for UnetConfig {
    fn default() -> Self {
        use UnetBlock::{CrossAttention, Plain};
        Self {
            in_channels: 4,
            out_channels: 4,
            flip_sin_to_cos: true,
            freq_shift: 0.0,
            down_block_types: vec![CrossAttention, CrossAttention, CrossAttention, Plain],
            up_block_types: vec![Plain, CrossAttention, CrossAttention, CrossAttention],
            only_cross_attention: PerBlock::Same(false),
            block_out_channels: vec![320, 640, 1280, 1280],
            layers_per_block: PerBlock::Same(2),
            norm_num_groups: 32,
            norm_eps: 1e-5,
            cross_attention_dim: PerBlock::Same(1280),
            transformer_layers_per_block: PerBlock::Same(1),
            attention_head_dim: PerBlock::Same(8),
            use_linear_projection: false,
            num_class_embeds: None,
        }
    }
}

impl UnetConfig {
    pub(crate) fn read(file: &ModelFile) -> Result<Self, ModelError> {
        let fixed = json!({
            "act_fn": "silu", "addition_embed_type": null, "attention_type": "default", "center_input_sample": false,
            "class_embed_type": null, "class_embeddings_concat": false, "conv_in_kernel": 3, "conv_out_kernel": 3,
            "cross_attention_norm": null, "downsample_padding": 1, "dual_cross_attention": false, "encoder_hid_dim": null,
            "encoder_hid_dim_type": null, "mid_block_scale_factor": 1, "mid_block_type": "UNetMidBlock2DCrossAttn",
            "num_attention_heads": null, "resnet_out_scale_factor": 1, "resnet_skip_time_act": false,
            "resnet_time_scale_shift": "default", "reverse_transformer_layers_per_block": null,
            "time_cond_proj_dim": null, "time_embedding_act_fn": null, "time_embedding_dim": null,
            "time_embedding_type": "positional", "timestep_post_act": null,
        });
        // Without effect on what these networks compute in f32.
        let idle = [
            "addition_embed_type_num_heads",
            "addition_time_embed_dim",
            "dropout",
            "mid_block_only_cross_attention",
            "projection_class_embeddings_input_dim",
            "sample_size",
            "upcast_attention",
        ];
        let config: Self = parse(file, &fixed, &idle)?;
        config.check(&file.name)?;
        Ok(config)
    }

    fn check(&self, file: &str) -> Result<(), ModelError> {
        let blocks = self.block_out_channels.len();
        let per_block = [
            ("down_block_types", self.down_block_types.len()),
            ("up_block_types", self.up_block_types.len()),
            ("layers_per_block", self.layers_per_block.count(blocks)),
            ("cross_attention_dim", self.cross_attention_dim.count(blocks)),
            ("transformer_layers_per_block", self.transformer_layers_per_block.count(blocks)),
            ("attention_head_dim", self.attention_head_dim.count(blocks)),
            ("only_cross_attention", self.only_cross_attention.count(blocks)),
        ];
        check_lengths(file, blocks, &per_block)?;
        let sizes = [
            ("in_channels", &[self.in_channels][..]),
            ("out_channels", &[self.out_channels]),
            ("block_out_channels", &self.block_out_channels),
            ("layers_per_block", self.layers_per_block.all()),
            ("norm_num_groups", &[self.norm_num_groups]),
            ("cross_attention_dim", self.cross_attention_dim.all()),
            ("transformer_layers_per_block", self.transformer_layers_per_block.all()),
            ("attention_head_dim", self.attention_head_dim.all()),
            ("num_class_embeds", &[self.num_class_embeds.unwrap_or(1)]),
        ];
        check_sizes(file, &sizes)?;
        if !self.block_out_channels[0].is_multiple_of(2) {
            // Half of them are the timestep's sines, half its cosines.
            return Err(ModelError::field(file, "block_out_channels[0]", "is odd; it must be even"));
        }
        check_divisors(file, "norm_num_groups", &self.block_out_channels, |_| self.norm_num_groups)?;
        check_divisors(file, "attention_head_dim", &self.block_out_channels, |i| self.attention_head_dim.of(i))
    }
}

impl<T> PerBlock<T> {
    fn count(&self, blocks: usize) -> usize {
        match self {
            Self::Same(_) => blocks,
            Self::Each(values) => values.len(),
        }
    }
}

/// `AutoencoderKL`.
#[derive(Clone, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs)]
pub struct VaeConfig {
    pub in_channels: usize,
    pub out_channels: usize,
    pub block_out_channels: Vec<usize>,
    pub layers_per_block: usize,
    pub latent_channels: usize,
    pub norm_num_groups: usize,
    /// What a latent is multiplied by before the UNet sees it.
    pub scaling_factor: f64,
    pub use_quant_conv: bool,
    pub use_post_quant_conv: bool,
    pub mid_block_add_attention: bool,
    down_block_types: Vec<EncoderBlock>,
    up_block_types: Vec<DecoderBlock>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum EncoderBlock {
    #[serde(rename = "DownEncoderBlock2D")]
    Plain,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum DecoderBlock {
    #[serde(rename = "UpDecoderBlock2D")]
    Plain,
}

impl Default for VaeConfig {
    fn default() -> Self {
        Self {
            in_channels: 3,
            out_channels: 3,
            block_out_channels: vec![64],
            layers_per_block: 1,
            latent_channels: 4,
            norm_num_groups: 32,
            scaling_factor: 0.18215,
            use_quant_conv: true,
            use_post_quant_conv: true,
            mid_block_add_attention: true,
            down_block_types: vec![EncoderBlock::Plain],
            up_block_types: vec![DecoderBlock::Plain],
        }
    }
}

impl VaeConfig {
    pub(crate) fn read(file: &ModelFile) -> Result<Self, ModelError> {
        let fixed = json!({ "act_fn": "silu", "latents_mean": null, "latents_std": null, "shift_factor": null });
        let config: Self = parse(file, &fixed, &["force_upcast", "sample_size"])?;
        config.check(&file.name)?;
        Ok(config)
    }

    fn check(&self, file: &str) -> Result<(), ModelError> {
        let per_block =
            [("down_block_types", self.down_block_types.len()), ("up_block_types", self.up_block_types.len())];
        check_lengths(file, self.block_out_channels.len(), &per_block)?;
        let sizes = [
            ("in_channels", &[self.in_channels][..]),
            ("out_channels", &[self.out_channels]),
            ("block_out_channels", &self.block_out_channels),
            ("layers_per_block", &[self.layers_per_block]),
            ("latent_channels", &[self.latent_channels]),
            ("norm_num_groups", &[self.norm_num_groups]),
        ];
        check_sizes(file, &sizes)?;
        if !(self.scaling_factor.is_finite() && self.scaling_factor > 0.0) {
            let problem = format!("is {}; it must be above 0", self.scaling_factor);
            return Err(ModelError::field(file, "scaling_factor", problem));
        }
        check_divisors(file, "norm_num_groups", &self.block_out_channels, |_| self.norm_num_groups)
    }
}

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
    pub(crate) fn read(file: &ModelFile) -> Result<Self, ModelError> {
        let config: Self = parse(file, &json!({ "model_type": "clip_text_model" }), &[])?;
        let sizes = [
            ("vocab_size", config.vocab_size >> 8),
            ("hidden_size", config.hidden_size),
            ("intermediate_size", config.intermediate_size),
            ("num_hidden_layers", config.num_hidden_layers),
            ("num_attention_heads", config.num_attention_heads),
            ("max_position_embeddings", config.max_position_embeddings),
        ];
        for (field, size) in sizes {
            check_sizes(&file.name, &[(field, &[size])])?;
        }
        check_divisors(&file.name, "num_attention_heads", &[config.hidden_size], |_| config.num_attention_heads)?;
        Ok(config)
    }
}

/// Reads a configuration. Fields of `fixed` must have the value given there (or be absent); fields of `idle` and those that begin
/// with an underscore may have any.
pub(crate) fn parse<T: DeserializeOwned>(file: &ModelFile, fixed: &Value, idle: &[&str]) -> Result<T, ModelError> {
    let mut fields: Map<String, Value> =
        serde_json::from_slice(file).map_err(|e| ModelError::file(&file.name, format!("is not a JSON object: {e}")))?;
    fields.retain(|name, _| !name.starts_with('_') && !idle.contains(&name.as_str()));
    for (name, supported) in fixed.as_object().into_iter().flatten() {
        match fields.remove(name) {
            Some(value) if !same(&value, supported) => {
                return Err(ModelError::field(&file.name, name, format!("is {value}; supported is {supported}")));
            }
            _ => {}
        }
    }
    serde_path_to_error::deserialize(Value::Object(fields))
        .map_err(|e| ModelError::field(&file.name, e.path().to_string(), format!("cannot be used: {}", e.inner())))
}

/// Equal, where 1 and 1.0 are, and an absent value may be written as null.
fn same(value: &Value, supported: &Value) -> bool {
    value.is_null() || value == supported || value.as_f64().is_some_and(|v| Some(v) == supported.as_f64())
}

fn check_lengths(file: &str, blocks: usize, counts: &[(&str, usize)]) -> Result<(), ModelError> {
    if blocks == 0 {
        return Err(ModelError::field(file, "block_out_channels", "is empty"));
    }
    match counts.iter().find(|(_, count)| *count != blocks) {
        Some((field, count)) => {
            let problem = format!("has {count} entries; `block_out_channels` has {blocks}");
            Err(ModelError::field(file, *field, problem))
        }
        None => Ok(()),
    }
}

fn check_sizes(file: &str, sizes: &[(&str, &[usize])]) -> Result<(), ModelError> {
    let wrong = |size: &usize| !(1..=MAX_SIZE).contains(size);
    match sizes.iter().find_map(|(field, sizes)| sizes.iter().find(|size| wrong(size)).map(|size| (field, size))) {
        Some((field, size)) => {
            Err(ModelError::field(file, *field, format!("is {size}; it must be from 1 to {MAX_SIZE}")))
        }
        None => Ok(()),
    }
}

fn check_divisors(file: &str, field: &str, channels: &[usize], of: impl Fn(usize) -> usize) -> Result<(), ModelError> {
    match channels.iter().enumerate().find(|(i, channels)| !channels.is_multiple_of(of(*i))) {
        Some((i, channels)) => {
            Err(ModelError::field(file, field, format!("is {}, which does not divide {channels}", of(i))))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::ModelSource;

    fn with_file<T>(text: &str, read: impl Fn(&ModelFile) -> Result<T, ModelError>) -> Result<T, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("config.json"), text).unwrap();
        let file = ModelSource::Folder(folder.path().to_owned()).file("config.json").unwrap();
        read(&file).map_err(|e| e.to_string().rsplit_once("config.json: ").unwrap().1.to_owned())
    }

    fn refusal(text: &str) -> String {
        with_file(text, UnetConfig::read).unwrap_err()
    }

    #[test]
    fn what_the_networks_do_not_have_is_refused_by_name() {
        assert_eq!(refusal(r#"{"act_fn": "mish"}"#), r#"`act_fn` is "mish"; supported is "silu""#);
        assert_eq!(refusal(r#"{"mid_block_scale_factor": 1.5}"#), "`mid_block_scale_factor` is 1.5; supported is 1");
        let block = refusal(r#"{"down_block_types": ["DownBlock2D", "AttnDownBlock2D"]}"#);
        assert!(
            block.starts_with("`down_block_types[1]` cannot be used: unknown variant `AttnDownBlock2D`"),
            "{block}"
        );
        let unknown = refusal(r#"{"hyper_network": 3}"#);
        assert!(unknown.contains("unknown field `hyper_network`"), "{unknown}");
        let encoder = with_file(r#"{"down_block_types": ["AttnDownEncoderBlock2D"]}"#, VaeConfig::read).unwrap_err();
        assert!(encoder.starts_with("`down_block_types[0]` cannot be used: unknown variant"), "{encoder}");
        let text = with_file(r#"{"hidden_act": "relu"}"#, TextConfig::read).unwrap_err();
        assert!(text.starts_with("`hidden_act` cannot be used: unknown variant `relu`"), "{text}");
    }

    #[test]
    fn what_does_not_fit_together_is_refused_by_name() {
        assert_eq!(refusal("[]").split(':').next(), Some("is not a JSON object"));
        assert_eq!(
            refusal(r#"{"block_out_channels": [320, 640]}"#),
            "`down_block_types` has 4 entries; `block_out_channels` has 2"
        );
        assert_eq!(refusal(r#"{"norm_num_groups": 7}"#), "`norm_num_groups` is 7, which does not divide 320");
        assert_eq!(
            refusal(r#"{"attention_head_dim": [8, 8, 8, 0]}"#),
            "`attention_head_dim` is 0; it must be from 1 to 65536"
        );
        assert_eq!(refusal(r#"{"in_channels": 99999999}"#), "`in_channels` is 99999999; it must be from 1 to 65536");
    }

    #[test]
    fn defaults_and_the_ways_to_write_a_value_are_those_of_diffusers() {
        let text = r#"{"_class_name": "x", "mid_block_scale_factor": 1.0, "upcast_attention": null, "num_class_embeds": null,
            "layers_per_block": [1, 2, 3, 4], "encoder_hid_dim": null, "sample_size": 128}"#;
        let config = with_file(text, UnetConfig::read).unwrap();
        assert_eq!((config.layers_per_block.of(2), config.attention_head_dim.of(2)), (3, 8));
        assert_eq!(config.block_out_channels, [320, 640, 1280, 1280]);
    }
}
