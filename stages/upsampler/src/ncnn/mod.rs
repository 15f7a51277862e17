//! Networks as ncnn keeps them: a graph of layers as text, `.param`, and their weights in the order
//! of the layers, `.bin`. The layers that super-resolution networks are made of are computed as the
//! graph says; anything else is refused by the layer's name and line.

mod activation;
mod blob;
mod build;
mod graph;
mod kinds;
mod layer;
mod param;
mod parameters;
mod shuffle;
mod weights;

use std::collections::BTreeMap;

use compute::Device;
use formats::FileBytes;

use crate::error::UpsamplerError;
use crate::network::Network;

/// A network, for each number type how many numbers it has, and how many arrays those are.
type Read = (Box<dyn Network>, BTreeMap<String, usize>, usize);

/// The network of a graph and its weights, which must be used up.
pub fn read(
    graph: &FileBytes,
    weights: &FileBytes,
    device: &Device,
) -> Result<Read, UpsamplerError> {
    let layers = param::parse(graph)?;
    let mut weights = weights::Weights::new(weights, device);
    let network = build::build(&layers, &mut weights)?;
    // After the graph: weights that are left over show that the two files do not belong together.
    let (types, count) = weights.finish()?;
    Ok((Box::new(network), types, count))
}
