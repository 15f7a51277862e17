//! Whether a file of tensors is the x4 upscaler, told by names and by one shape. Reads no numbers.

use formats::TensorFile;

use super::error::SingleFileError;
use super::names::prefix;
use crate::network::Network;

/// Names longer than this are cut in messages.
const SHOWN: usize = 100;

/// What other files of this layout are, by how their names begin.
const OTHERS: [(&str, &str, &str); 3] = [
    (
        "conditioner.embedders.",
        "Stable Diffusion XL",
        "its text encoders are `conditioner.embedders.*`, the upscaler's is `cond_stage_model.model.*`",
    ),
    (
        "cond_stage_model.transformer.",
        "Stable Diffusion 1",
        "its text encoder is CLIP's, `cond_stage_model.transformer.*`, the upscaler's is OpenCLIP's, `cond_stage_model.model.*`",
    ),
    (
        "down_blocks.",
        "a network out of a folder of diffusers",
        "it has `down_blocks.*`; name the model's folder by `Folder(..)`",
    ),
];

/// Fails for another model by saying which, and what tells.
pub(super) fn check(file: &TensorFile) -> Result<(), SingleFileError> {
    let other = |model, why: String| {
        let file = file.name().to_owned();
        Err(SingleFileError::OtherModel { file, model, why })
    };
    let begins = |start: &str| file.names().any(|name| name.starts_with(start));
    // Asked first, since Stable Diffusion 1 and XL put the same prefix before their UNets' names.
    if let Some((_, model, why)) = OTHERS.iter().find(|(start, ..)| begins(start)) {
        return other(model, (*why).to_owned());
    }
    if !begins(prefix(Network::Unet)) {
        let first: String = file
            .names()
            .next()
            .unwrap_or("")
            .chars()
            .take(SHOWN)
            .collect();
        let why = format!("it has no `model.diffusion_model.*`, its first tensor is `{first}`");
        return other("no model of latent diffusion", why);
    }
    // Models of Stable Diffusion 2 have the upscaler's prefixes. This shape tells them apart.
    match channels(file) {
        Some((taken, latent)) if taken != latent + 3 => {
            let wanted = latent + 3;
            let why = format!(
                "its UNet takes {taken} channels, the upscaler's {wanted}: a latent's {latent} and three colours"
            );
            other(model_of(taken, latent), why)
        }
        _ => Ok(()),
    }
}

/// The channels that the UNet takes, and those of a latent; what is missing is said elsewhere.
fn channels(file: &TensorFile) -> Option<(usize, usize)> {
    let taken = |network, layer: &str| {
        let name = format!("{}{layer}.weight", prefix(network));
        file.entry(&name).ok()?.shape().get(1).copied()
    };
    let unet = taken(Network::Unet, "input_blocks.0.0")?;
    Some((unet, taken(Network::Vae, "decoder.conv_in")?))
}

/// Which model of Stable Diffusion 2 has a UNet of so many channels.
fn model_of(taken: usize, latent: usize) -> &'static str {
    match taken.checked_sub(latent) {
        Some(0) => "Stable Diffusion 2 for text to image",
        Some(1) => "Stable Diffusion 2 with depth",
        Some(5) => "Stable Diffusion 2 for inpainting",
        _ => "another model of latent diffusion",
    }
}
