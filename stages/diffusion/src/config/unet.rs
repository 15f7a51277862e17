//! The configuration of a UNet.

use formats::FileBytes;
use serde::Deserialize;
use serde_json::json;

use super::check::{check_divisors, check_lengths, check_sizes};
use super::{PerBlock, parse};
use crate::error::ModelError;

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

/// The options of `UNet2DConditionModel` that the supported models use, by their names in
/// `unet/config.json`.
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
    /// Whether both attentions of a transformer look at the text, in place of the image and the
    /// text. The mid block's never do.
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
    /// Reads and checks a `config.json`; the error names the field.
    pub fn read(file: &FileBytes) -> Result<Self, ModelError> {
        // Each of these changes what is computed. Another value needs code that is not here, so it
        // must not be passed over.
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
        config.check(file.name())?;
        Ok(config)
    }

    fn check(&self, file: &str) -> Result<(), ModelError> {
        let blocks = self.block_out_channels.len();
        let per_block = [
            ("down_block_types", self.down_block_types.len()),
            ("up_block_types", self.up_block_types.len()),
            ("layers_per_block", self.layers_per_block.count(blocks)),
            (
                "cross_attention_dim",
                self.cross_attention_dim.count(blocks),
            ),
            (
                "transformer_layers_per_block",
                self.transformer_layers_per_block.count(blocks),
            ),
            ("attention_head_dim", self.attention_head_dim.count(blocks)),
            (
                "only_cross_attention",
                self.only_cross_attention.count(blocks),
            ),
        ];
        // First of all checks, since the others look up a list's entry by the block's number.
        check_lengths(file, blocks, &per_block)?;
        let sizes = [
            ("in_channels", &[self.in_channels][..]),
            ("out_channels", &[self.out_channels]),
            ("block_out_channels", &self.block_out_channels),
            ("layers_per_block", self.layers_per_block.all()),
            ("norm_num_groups", &[self.norm_num_groups]),
            ("cross_attention_dim", self.cross_attention_dim.all()),
            (
                "transformer_layers_per_block",
                self.transformer_layers_per_block.all(),
            ),
            ("attention_head_dim", self.attention_head_dim.all()),
            // A network without classes is fine, a table of none is not.
            ("num_class_embeds", &[self.num_class_embeds.unwrap_or(1)]),
        ];
        check_sizes(file, &sizes)?;
        let widths = self.cross_attention_dim.all();
        if let Some(other) = widths.iter().find(|width| **width != widths[0]) {
            let problem = format!("is {} and {other}; one text goes to all blocks", widths[0]);
            return Err(ModelError::field(file, "cross_attention_dim", problem));
        }
        // Frequencies are divided by the difference.
        if (self.block_out_channels[0] / 2) as f32 == self.freq_shift {
            let problem = "is half of the first block's channels";
            return Err(ModelError::field(file, "freq_shift", problem));
        }
        if !self.block_out_channels[0].is_multiple_of(2) {
            // Half of them are the timestep's sines, half its cosines.
            return Err(ModelError::field(
                file,
                "block_out_channels[0]",
                "is odd; it must be even",
            ));
        }
        check_divisors(file, "norm_num_groups", &self.block_out_channels, |_| {
            self.norm_num_groups
        })?;
        check_divisors(file, "attention_head_dim", &self.block_out_channels, |i| {
            self.attention_head_dim.of(i)
        })
    }
}
