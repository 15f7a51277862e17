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
    /// The network that predicts velocities of noised latents.
    pub unet: Unet,
    /// The autoencoder between images and latents.
    pub vae: Vae,
    /// The noise schedule of latents.
    pub schedule: Schedule,
    /// The noise schedule of the low-resolution image.
    pub low_schedule: Schedule,
    /// From a prompt to token ids.
    pub tokenizer: Tokenizer,
    /// From token ids to the states that the UNet attends to.
    pub text_encoder: TextEncoder,
    /// The highest noise level, as a timestep of `low_schedule`, that the low-resolution image was
    /// trained with.
    pub max_noise_level: u32,
}

/// The x4 upscaler's highest noise level: what diffusers takes where a model does not say.
const MAX_NOISE_LEVEL: u32 = 350;

#[derive(Default, Deserialize)]
#[serde(default)]
struct ModelIndex {
    max_noise_level: Option<u32>,
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
        let unet_config = UnetConfig::read(&unet_file)?;
        // Before any weights: parts of two models are told apart in a moment, not after gigabytes
        // were read.
        check_widths(&unet_file, &unet_config, &vae_config, &text_config)?;
        let schedule_file = source.file("scheduler/scheduler_config.json")?;
        let low_file = source.find("low_res_scheduler/scheduler_config.json")?;
        let low_schedule = schedule(low_file.as_ref().unwrap_or(&schedule_file))?;
        Ok(Self {
            schedule: schedule(&schedule_file)?,
            tokenizer: Tokenizer::load(source, &text_config)?,
            max_noise_level: max_noise_level(source, &low_schedule, &unet_config)?,
            low_schedule,
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
    // Either would give other betas than the formula. Rescaled, a is 0 at the last timestep, and
    // predicted noise is divided by a.
    let fixed = json!({ "rescale_betas_zero_snr": false, "trained_betas": null });
    let config: SchedulerConfig = config::parse(file, &fixed, &[])?;
    Schedule::new(&config, file.name())
}

/// What the model says, where both the schedule and the UNet's labels have such a level.
fn max_noise_level(
    source: &ModelSource,
    low_schedule: &Schedule,
    unet: &UnetConfig,
) -> Result<u32, ModelError> {
    // A UNet without labels takes any level.
    let labels = unet
        .num_class_embeds
        .map_or(u32::MAX, |labels| labels as u32);
    // Both are at least 1, since their files were checked, so that `levels - 1` does not wrap.
    let levels = low_schedule.len().min(labels);
    let Some(file) = source.find("model_index.json")? else {
        return Ok(MAX_NOISE_LEVEL.min(levels - 1));
    };
    let index: ModelIndex = config::parse(&file, &json!({}), &[])?;
    match index.max_noise_level {
        Some(level) if level >= levels => Err(ModelError::field(
            file.name(),
            "max_noise_level",
            format!(
                "is {level}; the low-resolution schedule and the UNet's `num_class_embeds` have levels 0 to {}",
                levels - 1
            ),
        )),
        told => Ok(told.unwrap_or(MAX_NOISE_LEVEL.min(levels - 1))),
    }
}

/// The UNet takes latents and a colour image, gives latents, and looks at the text's states.
fn check_widths(
    file: &FileBytes,
    unet: &UnetConfig,
    vae: &VaeConfig,
    text: &TextConfig,
) -> Result<(), ModelError> {
    let latent = vae.latent_channels;
    let pairs = [
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
        (
            "cross_attention_dim",
            // That of all blocks: a configuration with several is refused.
            unet.cross_attention_dim.of(0),
            text.hidden_size,
            "the text encoder's width",
        ),
    ];
    match pairs.iter().find(|(_, is, needed, _)| is != needed) {
        Some((field, is, needed, what)) => Err(ModelError::field(
            file.name(),
            *field,
            format!("is {is}; {what} ask for {needed}"),
        )),
        None => Ok(()),
    }
}
