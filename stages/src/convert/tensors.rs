//! Tensors on disk and what the libraries make of them.

use std::collections::BTreeMap;

use artifacts_schema::{self as disk, LatentView, StoredLatents};
use compute::{Array, Device};
use diffusion::optimize::LoraParameters;
use formats::Tensor;
use nerf::{Field, FieldConfig};

use crate::error::StageError;

/// An array for disk, without its leading axis of length 1.
pub fn tensor(array: &Array) -> Tensor {
    Tensor {
        // A file has one view a tensor: [1, C, h, w] is [C, h, w] there.
        shape: array.shape()[1..].to_vec(),
        values: array.to_vec(),
    }
}

/// A tensor as an array with a leading axis of length 1.
pub fn latent_array(tensor: &Tensor, device: &Device) -> Array {
    let shape: Vec<usize> = [1].iter().chain(&tensor.shape).copied().collect();
    device.array(&shape, tensor.values.clone())
}

/// The latent of this name.
pub fn latent_named(latents: &StoredLatents, name: &str) -> Result<LatentView, StageError> {
    let at = latents.find(name).ok_or_else(|| {
        StageError::Mismatch(format!("an input latent set has no view named `{name}`"))
    })?;
    Ok(latents.view(at)?)
}

/// A field that can be rendered and trained.
pub fn field(field: disk::Field) -> Result<Field, StageError> {
    let config: FieldConfig = serde_json::from_value(field.config).map_err(|error| {
        StageError::Mismatch(format!("the field's configuration is not ours: {error}"))
    })?;
    let tensors = field
        .tensors
        .into_iter()
        .map(|(name, t)| (name, (t.shape, t.values)))
        .collect();
    // Fields compute in f32; the file has f64, in which every f32 is exact, so that the way back
    // loses nothing.
    let bounds = field.bounds.map(|corner| corner.map(|x| x as f32));
    Field::from_tensors(&config, bounds, &tensors)
        .map_err(|error| StageError::Mismatch(error.to_string()))
}

/// A field for disk.
pub fn disk_field(field: &Field) -> Result<disk::Field, StageError> {
    let config = serde_json::to_value(field.config())
        .map_err(|error| StageError::Mismatch(error.to_string()))?;
    let tensors = field
        .tensors()
        .into_iter()
        .map(|(name, (shape, values))| (name, Tensor { shape, values }))
        .collect();
    Ok(disk::Field {
        config,
        tensors,
        bounds: field.bounds().map(|corner| corner.map(f64::from)),
    })
}

/// LoRA weights and camera embedding for disk; what is no adapter belongs to the embedding. The
/// scale is 1: alpha is the rank.
pub fn lora(parameters: &LoraParameters) -> disk::Lora {
    let tensor = |array: &Array| Tensor {
        shape: array.shape().to_vec(),
        values: array.to_vec(),
    };
    let (tensors, camera): (BTreeMap<_, _>, BTreeMap<_, _>) = parameters
        .iter()
        .map(|(name, a)| (name.clone(), tensor(a)))
        .partition(|(name, _)| name.contains(".lora_"));
    let rank = tensors
        .iter()
        .find(|(name, _)| name.contains(".lora_A."))
        .map_or(0, |(_, down)| down.shape[0]);
    disk::Lora {
        rank,
        alpha: rank as f64,
        tensors,
        camera,
    }
}
