//! What a model is made of: every part read as it would be for a run, and described.
//!
//! Knows names and sizes; says nothing of what the networks compute.

use std::collections::BTreeMap;

use compute::Device;
use formats::TensorFile;

use crate::error::ModelError;
use crate::prior::Prior;
use crate::source::ModelSource;
use crate::weights;

/// One network of a model.
#[derive(Clone, Debug)]
pub struct PartReport {
    /// Its folder.
    pub name: &'static str,
    /// How many tensors its files hold.
    pub tensors: usize,
    /// How many numbers those are.
    pub parameters: usize,
    /// For each number type that the files use, how many.
    pub types: BTreeMap<String, usize>,
    /// The bytes that the weights take once they are read.
    pub memory: usize,
    /// The configuration in a few words.
    pub summary: String,
}

/// Reads a model whole, every weight of it. The error names the file, and the field or tensor in
/// it, that cannot be used.
pub fn inspect(source: &ModelSource, device: &Device) -> Result<Vec<PartReport>, ModelError> {
    let prior = Prior::load(source, device)?;
    let unet = prior.unet.config();
    let vae = prior.vae.config();
    let text = prior.text_encoder.config();
    let summaries = [
        format!(
            "{} to {} channels, blocks of {:?}",
            unet.in_channels, unet.out_channels, unet.block_out_channels
        ),
        format!(
            "{} latent channels, scaled by {}, blocks of {:?}",
            vae.latent_channels, vae.scaling_factor, vae.block_out_channels
        ),
        format!("{} layers of {}", text.num_hidden_layers, text.hidden_size),
    ];
    let stems = [
        ("unet", "unet/diffusion_pytorch_model"),
        ("vae", "vae/diffusion_pytorch_model"),
        ("text_encoder", "text_encoder/model"),
    ];
    stems
        .into_iter()
        .zip(summaries)
        .map(|((name, stem), summary)| report(source, name, stem, summary))
        .collect()
}

fn report(
    source: &ModelSource,
    name: &'static str,
    stem: &str,
    summary: String,
) -> Result<PartReport, ModelError> {
    let files = source
        .weights(stem)?
        .into_iter()
        .map(TensorFile::new)
        .collect::<Result<Vec<_>, _>>()?;
    let mut types = BTreeMap::new();
    for (dtype, count) in files.iter().flat_map(TensorFile::counts) {
        *types.entry(dtype).or_default() += count;
    }
    let tensors = files.iter().map(|file| file.names().count()).sum();
    let parameters = types.values().sum();
    Ok(PartReport {
        name,
        tensors,
        parameters,
        types,
        memory: weights::memory(&files),
        summary,
    })
}
