//! What a model is made of: every part read as it would be for a run, and described.
//!
//! Knows names and sizes; says nothing of what the networks compute.

use std::collections::BTreeMap;

use compute::Device;

use crate::error::ModelError;
use crate::network::Network;
use crate::prior::Prior;
use crate::source::ModelSource;

/// One network of a model.
#[derive(Clone, Debug)]
pub struct PartReport {
    /// Its folder in the layout of diffusers, such as `unet`.
    pub name: &'static str,
    /// How many tensors its files hold of it.
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
    // Shapes, and whether numbers are finite, show only where a tensor is read: all of them are, as
    // for a run.
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
    [Network::Unet, Network::Vae, Network::TextEncoder]
        .into_iter()
        .zip(summaries)
        .map(|(network, summary)| report(source, network, summary, device))
        .collect()
}

fn report(
    source: &ModelSource,
    network: Network,
    summary: String,
    device: &Device,
) -> Result<PartReport, ModelError> {
    let weights = source.weights(network, device)?;
    let types = weights.types();
    Ok(PartReport {
        name: network.folder(),
        tensors: weights.len(),
        parameters: types.values().sum(),
        memory: weights.memory(),
        types,
        summary,
    })
}
