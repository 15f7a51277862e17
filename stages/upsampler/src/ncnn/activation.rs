//! The layers that are a function of each number by itself.

use super::kinds::unknown;
use super::layer::{Function, Operation};
use super::param::Layer;
use super::parameters::Parameters;
use super::weights::Weights;
use crate::error::UpsamplerError;

/// The function of a layer that takes so many channels.
pub fn activation(
    layer: &Layer,
    channels: usize,
    parameters: &mut Parameters,
    weights: &mut Weights,
) -> Result<Operation, UpsamplerError> {
    let function = match layer.kind.as_str() {
        "ReLU" => Function::Leaky(parameters.number(0, 0.0)? as f32),
        "Sigmoid" => Function::Sigmoid,
        "Swish" => Function::Swish,
        "Clip" => clip(layer, parameters)?,
        "PReLU" => return prelu(layer, channels, parameters, weights),
        _ => return Err(unknown(layer)),
    };
    Ok(Operation::Function(function))
}

fn clip(layer: &Layer, parameters: &mut Parameters) -> Result<Function, UpsamplerError> {
    // Without bounds ncnn's Clip leaves every number as it is.
    let low = parameters.number(0, f64::from(f32::MIN))?;
    let high = parameters.number(1, f64::from(f32::MAX))?;
    if low > high {
        return Err(layer.wrong(format!("leaves nothing between {low} and {high}")));
    }
    Ok(Function::Clamp(low as f32, high as f32))
}

fn prelu(
    layer: &Layer,
    channels: usize,
    parameters: &mut Parameters,
    weights: &mut Weights,
) -> Result<Operation, UpsamplerError> {
    match parameters.count(0, 0)? {
        1 => {
            let slope = weights.plain(layer, &[1])?.to_vec()[0];
            Ok(Operation::Function(Function::Leaky(slope)))
        }
        count if count == channels => Ok(Operation::Prelu(weights.plain(layer, &[count])?)),
        count => Err(layer.wrong(format!("has {count} slopes for {channels} channels"))),
    }
}
