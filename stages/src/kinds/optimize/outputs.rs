//! What `Optimize` gives: refined latents, residuals, LoRA and log. Knows nothing of how they came
//! about.

use artifacts_schema::{LatentView, Latents, Log, Residuals};
use compute::Array;
use compute::elementwise::add;
use diffusion::optimize::{Optimized, ViewLatents};

use super::{LATENTS, LOG, LORA, RESIDUALS};
use crate::convert;
use crate::error::StageError;
use crate::io::Io;

/// Writes all outputs. `views` are those of `latents`, in their order.
pub(super) fn write(
    latents: &Latents,
    views: &[ViewLatents],
    optimized: Optimized,
    io: &Io,
) -> Result<(), StageError> {
    let batched = |array: &Array| {
        let shape: Vec<usize> = [1].iter().chain(array.shape()).copied().collect();
        convert::tensor(&array.reshape(&shape))
    };
    let residuals = optimized.residuals.iter();
    let refined = with_tensors(
        latents,
        residuals
            .clone()
            .zip(views)
            .map(|(h, view)| batched(&add(&view.latent, h))),
    );
    io.write(LATENTS, &refined)?;
    io.write(
        RESIDUALS,
        &Residuals(with_tensors(latents, residuals.map(batched))),
    )?;
    if let Some(lora) = &optimized.lora {
        io.write(LORA, &convert::lora(lora))?;
    }
    let lines = optimized
        .log
        .iter()
        .map(serde_json::to_value)
        .collect::<Result<_, _>>();
    io.write(
        LOG,
        &Log {
            lines: lines.map_err(|error| StageError::Mismatch(error.to_string()))?,
        },
    )
}

/// The latents with other tensors.
fn with_tensors(latents: &Latents, tensors: impl Iterator<Item = formats::Tensor>) -> Latents {
    let views = latents
        .views
        .iter()
        .zip(tensors)
        .map(|(view, tensor)| LatentView {
            tensor,
            ..view.clone()
        })
        .collect();
    Latents {
        views,
        ..latents.clone()
    }
}
