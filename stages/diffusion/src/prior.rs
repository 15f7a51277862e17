//! All networks of one latent upscaler, read from one source.

use compute::{Array, Device, Precision};
use formats::FileBytes;
use serde::Deserialize;
use serde_json::json;

use crate::config::{self, TextConfig, UnetConfig, VaeConfig};
use crate::error::ModelError;
use crate::schedule::{Schedule, SchedulerConfig};
use crate::source::ModelSource;
use crate::text_encoder::TextEncoder;
use crate::tokenizer::Tokenizer;
use crate::unet::Unet;
use crate::vae::Vae;

/// A latent upscaler in the parts of diffusers' `StableDiffusionUpscalePipeline`.
pub struct Prior {
    /// The denoising network.
    pub unet: Unet,
    /// The autoencoder.
    pub vae: Vae,
    /// The noise schedule of latents.
    pub schedule: Schedule,
    /// The noise schedule of the low-resolution image.
    pub low_schedule: Schedule,
    /// Text to ids.
    pub tokenizer: Tokenizer,
    /// Ids to states.
    pub text_encoder: TextEncoder,
    /// The highest noise level, as a timestep of `low_schedule`, that the low-resolution image was
    /// trained with.
    pub max_noise_level: u32,
}

#[derive(Deserialize)]
#[serde(default)]
struct ModelIndex {
    max_noise_level: u32,
}

impl Default for ModelIndex {
    fn default() -> Self {
        Self {
            max_noise_level: 350,
        }
    }
}

impl Prior {
    /// Reads a model onto `device`. The error names the file, and the field or tensor in it, that
    /// cannot be used.
    pub fn load(source: &ModelSource, device: &Device) -> Result<Self, ModelError> {
        Self::load_in(source, device, Precision::F32)
    }

    /// [`Prior::load`] with a UNet that multiplies in `precision`. The autoencoder and the text
    /// encoder stay in `f32`.
    pub fn load_in(
        source: &ModelSource,
        device: &Device,
        precision: Precision,
    ) -> Result<Self, ModelError> {
        let unet_file = source.file("unet/config.json")?;
        let vae_config = VaeConfig::read(&source.file("vae/config.json")?)?;
        let text_config = TextConfig::read(&source.file("text_encoder/config.json")?)?;
        check_widths(
            &unet_file,
            &UnetConfig::read(&unet_file)?,
            &vae_config,
            &text_config,
        )?;
        let schedule_file = source.file("scheduler/scheduler_config.json")?;
        let low_file = source.find("low_res_scheduler/scheduler_config.json")?;
        Ok(Self {
            schedule: schedule(&schedule_file)?,
            low_schedule: schedule(low_file.as_ref().unwrap_or(&schedule_file))?,
            tokenizer: Tokenizer::load(source, &text_config)?,
            max_noise_level: max_noise_level(source)?,
            unet: Unet::load(source, device, precision)?,
            vae: Vae::load(source, device)?,
            text_encoder: TextEncoder::load(source, device)?,
        })
    }

    /// The text states `[N, T, D]` of N prompts.
    pub fn text(&self, prompts: &[&str]) -> Array {
        let ids: Vec<Vec<u32>> = prompts
            .iter()
            .map(|prompt| self.tokenizer.encode(prompt))
            .collect();
        self.text_encoder.forward(&ids)
    }
}

fn schedule(file: &FileBytes) -> Result<Schedule, ModelError> {
    let fixed = json!({ "rescale_betas_zero_snr": false, "trained_betas": null });
    let config: SchedulerConfig = config::parse(file, &fixed, &[])?;
    Schedule::new(&config, file.name())
}

fn max_noise_level(source: &ModelSource) -> Result<u32, ModelError> {
    let index: ModelIndex = match source.find("model_index.json")? {
        Some(file) => config::parse(&file, &json!({}), &[])?,
        None => ModelIndex::default(),
    };
    Ok(index.max_noise_level)
}

/// The UNet takes latents and a colour image, gives latents, and looks at the text's states.
fn check_widths(
    file: &FileBytes,
    unet: &UnetConfig,
    vae: &VaeConfig,
    text: &TextConfig,
) -> Result<(), ModelError> {
    let latent = vae.latent_channels;
    let mut pairs = vec![
        (
            "in_channels",
            unet.in_channels,
            latent + 3,
            "the autoencoder's latent channels and three colours",
        ),
        (
            "out_channels",
            unet.out_channels,
            latent,
            "the autoencoder's latent channels",
        ),
    ];
    for block in 0..unet.block_out_channels.len() {
        pairs.push((
            "cross_attention_dim",
            unet.cross_attention_dim.of(block),
            text.hidden_size,
            "the text encoder's width",
        ));
    }
    match pairs.iter().find(|(_, is, needed, _)| is != needed) {
        Some((field, is, needed, what)) => Err(ModelError::field(
            file.name(),
            *field,
            format!("is {is}; {what} ask for {needed}"),
        )),
        None => Ok(()),
    }
}
