//! What `Optimize` gives: refined latents, residuals, LoRA and log. Knows nothing of how they came
//! about.

use artifacts_schema::{LatentHeads, Log};
use compute::Array;
use compute::elementwise::add;
use diffusion::optimize::{Optimized, ViewLatents};

use super::{LATENTS, LOG, LORA, RESIDUALS};
use crate::convert;
use crate::error::StageError;
use crate::io::Io;

/// Writes all outputs. `views` are those of `heads`, in their order.
pub(super) fn write(
    heads: &LatentHeads,
    views: &[ViewLatents],
    optimized: Optimized,
    io: &Io,
) -> Result<(), StageError> {
    let batched = |array: &Array| {
        let shape: Vec<usize> = [1].iter().chain(array.shape()).copied().collect();
        convert::tensor(&array.reshape(&shape))
    };
    let mut refined = io.latent_writer(LATENTS, heads)?;
    let mut residuals = io.latent_writer(RESIDUALS, heads)?;
    for (view, residual) in views.iter().zip(&optimized.residuals) {
        refined.add(&view.name, &batched(&add(&view.latent, residual)))?;
        residuals.add(&view.name, &batched(residual))?;
    }
    refined.finish()?;
    residuals.finish()?;
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
