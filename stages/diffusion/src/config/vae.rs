//! The configuration of an autoencoder.

use formats::FileBytes;
use serde::Deserialize;
use serde_json::json;

use super::check::{check_divisors, check_lengths, check_sizes};
use super::parse;
use crate::error::ModelError;

/// The options of `AutoencoderKL` that the supported models use, by their names in
/// `vae/config.json`.
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
    // Their one kind each makes serde refuse all others, such as blocks with attentions.
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
    /// Reads and checks a `config.json`; the error names the field.
    pub fn read(file: &FileBytes) -> Result<Self, ModelError> {
        // Later models shift their latents (Stable Diffusion 3 by `shift_factor`). Passed over,
        // that would give other latents without an error.
        let fixed = json!({ "act_fn": "silu", "latents_mean": null, "latents_std": null, "shift_factor": null });
        // `force_upcast` asks for f32, in which the autoencoder always computes here.
        let config: Self = parse(file, &fixed, &["force_upcast", "sample_size"])?;
        config.check(file.name())?;
        Ok(config)
    }

    fn check(&self, file: &str) -> Result<(), ModelError> {
        let per_block = [
            ("down_block_types", self.down_block_types.len()),
            ("up_block_types", self.up_block_types.len()),
        ];
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
        check_divisors(file, "norm_num_groups", &self.block_out_channels, |_| {
            self.norm_num_groups
        })
    }
}
