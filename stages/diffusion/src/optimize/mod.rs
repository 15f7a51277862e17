//! The optimisation of residual latents: one for every view, guided by the diffusion prior, batch
//! by batch.
//!
//! Knows the networks only as a [`Denoiser`]. All its random numbers are functions of the seed and
//! of the step's number, so that [`State`] is all that a later run needs to go on with the same
//! bits.

mod batch;
mod denoiser;
mod error;
mod lora;
mod optimization;
mod options;
mod residual;
mod view;
mod window;

use std::ops::ControlFlow;

use compute::Array;
use serde::{Deserialize, Serialize};

pub use denoiser::{Denoiser, LoraParameters, Query};
pub use error::OptimizeError;
pub use lora::LoraState;
pub use optimization::Optimization;
pub use options::{Moments, Optimizer, Options};
pub use residual::Residual;
pub use view::ViewLatents;
pub use window::Window;

/// All that lies between two steps.
#[derive(Clone, Debug)]
pub struct State {
    /// Steps done, LoRA warm-up counted in.
    pub step: u64,
    /// Each view's residual, in the order of the views.
    pub residuals: Vec<Residual>,
    /// The LoRA, for variational score distillation.
    pub lora: Option<LoraState>,
}

/// What one step did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepLog {
    /// The step, from 0, LoRA warm-up counted in.
    pub step: u64,
    /// What the guidance did; nothing during warm-up.
    pub guidance: Option<GuidanceLog>,
    /// The LoRA's loss, a mean over all elements, where it learnt.
    pub lora_loss: Option<f64>,
}

/// What the guidance did in one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GuidanceLog {
    /// Mean timestep of the batch.
    pub timestep: f64,
    /// The loss, a mean over all elements.
    pub loss: f64,
    /// Root of the direction's mean square.
    pub direction: f64,
    /// Root of the residuals' mean square in the windows, after the step.
    pub residual: f64,
}

/// What the optimisation leaves behind.
#[derive(Clone, Debug)]
pub struct Optimized {
    /// Each view's residual latent h, `[C, h, w]`, in the order of the views.
    pub residuals: Vec<Array>,
    /// The LoRA, for variational score distillation.
    pub lora: Option<LoraParameters>,
    /// Every step in turn.
    pub log: Vec<StepLog>,
}

/// Runs all steps, or as many as `on_step` lets it.
pub fn optimize(
    prior: &dyn Denoiser,
    views: &[ViewLatents],
    options: &Options,
    seed: u64,
    on_step: &mut dyn FnMut(&StepLog) -> ControlFlow<()>,
) -> Result<Optimized, OptimizeError> {
    let mut optimization = Optimization::new(prior, views, options, seed)?;
    let mut log = Vec::new();
    while !optimization.is_done() {
        log.push(optimization.step()?);
        if log.last().is_some_and(|last| on_step(last).is_break()) {
            break;
        }
    }
    Ok(optimization.finish(log))
}
