//! The state of an optimisation as a checkpoint, and back.

use std::collections::BTreeMap;

use compute::adam::AdamState;
use compute::{Array, Device};
use diffusion::optimize::{LoraParameters, LoraState, Residual, State, StepLog};
use serde_json::json;

use crate::checkpoint::{Checkpoint, Tensors};

/// All that lies between two steps, with the log so far.
pub fn optimization_checkpoint(state: &State, log: &[StepLog]) -> Checkpoint {
    let mut tensors = Tensors::new();
    for (view, residual) in state.residuals.iter().enumerate() {
        let Residual {
            values,
            mean,
            square,
            visits,
            ..
        } = residual;
        // Visits stay far below 2^24, the last whole number that f32 holds exactly.
        let visits: Vec<f32> = visits.iter().map(|&visits| visits as f32).collect();
        for (name, values) in [
            ("values", values),
            ("mean", mean),
            ("square", square),
            ("visits", &visits),
        ] {
            tensors.insert(
                format!("residual.{view}.{name}"),
                (vec![values.len()], values.clone()),
            );
        }
    }
    for (name, values) in state.lora.iter().flat_map(|lora| &lora.parameters) {
        tensors.insert(
            format!("lora.{name}"),
            (values.shape().to_vec(), values.to_vec()),
        );
    }
    for (name, moments) in state.lora.iter().flat_map(|lora| &lora.moments) {
        tensors.insert(
            format!("lora.mean.{name}"),
            (moments.m.shape().to_vec(), moments.m.to_vec()),
        );
        tensors.insert(
            format!("lora.square.{name}"),
            (moments.v.shape().to_vec(), moments.v.to_vec()),
        );
    }
    // A note and no tensor, as f32 counts steps only up to 2^24.
    let lora_steps = state.lora.as_ref().map(|lora| lora.steps);
    Checkpoint {
        step: state.step,
        tensors,
        notes: json!({ "lora_steps": lora_steps, "log": log }),
    }
}

/// The state that a checkpoint holds; `like` is one of the same views and options.
pub fn optimization_state(
    checkpoint: &Checkpoint,
    like: &State,
    device: &Device,
) -> Result<State, String> {
    let tensors = &checkpoint.tensors;
    let residuals = like
        .residuals
        .iter()
        .enumerate()
        .map(|(view, like)| residual(tensors, view, like));
    let steps = checkpoint.notes["lora_steps"].as_u64();
    let lora = match (&like.lora, steps) {
        // A checkpoint of a rule without a LoRA has no steps of one.
        (None, None) => None,
        // Shapes are those of a fresh state, so that a file of other views is refused by name.
        (Some(like), Some(steps)) => Some(lora(tensors, like, steps, device)?),
        _ => return Err("it is of another kind of guidance".into()),
    };
    Ok(State {
        step: checkpoint.step,
        residuals: residuals.collect::<Result<_, _>>()?,
        lora,
    })
}

fn residual(tensors: &Tensors, view: usize, like: &Residual) -> Result<Residual, String> {
    let values = |name, like: usize| {
        // Lengths tell optimisers apart, too: plain descent has empty moments.
        Ok(take(tensors, &format!("residual.{view}.{name}"), &[like])?.to_vec())
    };
    let visits: Result<Vec<f32>, String> = values("visits", like.visits.len());
    Ok(Residual {
        shape: like.shape,
        values: values("values", like.values.len())?,
        mean: values("mean", like.mean.len())?,
        square: values("square", like.square.len())?,
        visits: visits?.into_iter().map(|visits| visits as u32).collect(),
    })
}

fn lora(
    tensors: &Tensors,
    like: &LoraState,
    steps: u64,
    device: &Device,
) -> Result<LoraState, String> {
    let array = |prefix: &str, name: &str, like: &Array| {
        let values = take(tensors, &format!("{prefix}{name}"), like.shape())?;
        Ok::<_, String>(device.array(like.shape(), values.to_vec()))
    };
    let mut parameters = LoraParameters::new();
    let mut moments = BTreeMap::new();
    for (name, like) in &like.parameters {
        parameters.insert(name.clone(), array("lora.", name, like)?);
    }
    for (name, like) in &like.moments {
        let m = array("lora.mean.", name, &like.m)?;
        let v = array("lora.square.", name, &like.v)?;
        moments.insert(name.clone(), AdamState { m, v });
    }
    Ok(LoraState {
        parameters,
        moments,
        steps,
    })
}

fn take<'t>(tensors: &'t Tensors, name: &str, shape: &[usize]) -> Result<&'t [f32], String> {
    match tensors.get(name) {
        Some((found, values)) if found == shape => Ok(values),
        Some((found, _)) => Err(format!("`{name}` has shape {found:?} instead of {shape:?}")),
        None => Err(format!("it has no `{name}`")),
    }
}
