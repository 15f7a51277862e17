//! One network asked about the tensors of a file: names and number types are those of diffusers'
//! arguments.
//!
//! Loads the one part that is asked, so that its memory is that of this part. Knows no command line
//! and writes nothing.

mod outputs;
mod text;
mod unet;
mod vae;

use std::path::Path;

use compute::{Array, Device, Precision};
use formats::{TensorError, TensorFile};

use crate::error::ModelError;
use crate::source::ModelSource;
use crate::stored::array;
pub use outputs::{Output, Outputs, to_safetensors};
use text::TextCall;
use unet::UnetCall;
use vae::VaeCall;

/// A part of a model that can be asked by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// `sample [N, C, h, w]`, `timestep [N]`, `encoder_hidden_states [N, S, D]`, `class_labels [N]`
    /// to `sample`.
    Unet,
    /// `sample [N, 3, H, W]` in [-1, 1] to `mean` and `logvar`, unscaled.
    VaeEncode,
    /// `latent`, unscaled, to `sample`.
    VaeDecode,
    /// `input_ids [N, T]` to `last_hidden_state`.
    Text,
}

/// What a part is asked beyond its tensors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked<'a> {
    /// A LoRA of the UNet.
    pub lora: Option<&'a Path>,
    /// Whether gradients of the mean squared error to the tensor `target` are wanted.
    pub gradients: bool,
    /// How many bytes of activations a backward pass may keep beside the layers' inputs.
    pub kept: usize,
    /// How the UNet multiplies; the other parts do it in f32.
    pub precision: Precision,
}

/// A loaded part with its inputs.
pub struct Call(Kind);

enum Kind {
    Unet(Box<UnetCall>),
    Vae(Box<VaeCall>),
    Text(Box<TextCall>),
}

impl Call {
    /// Loads `part` of the model and checks the tensors of `inputs` for it. Tensors that it does
    /// not take are not looked at.
    pub fn new(
        source: &ModelSource,
        part: Part,
        inputs: &TensorFile,
        asked: &Asked,
        device: &Device,
    ) -> Result<Self, ModelError> {
        // Refused rather than passed over: a result without the LoRA would look like one with it.
        if part != Part::Unet && (asked.lora.is_some() || asked.gradients) {
            return Err(ModelError::file(
                inputs.name(),
                "is for a part without LoRA and gradients; only the UNet has them",
            ));
        }
        Ok(Self(match part {
            Part::Unet => Kind::Unet(Box::new(UnetCall::new(source, inputs, asked, device)?)),
            Part::VaeEncode => Kind::Vae(Box::new(VaeCall::encode(source, inputs, device)?)),
            Part::VaeDecode => Kind::Vae(Box::new(VaeCall::decode(source, inputs, device)?)),
            Part::Text => Kind::Text(Box::new(TextCall::new(source, inputs, device)?)),
        }))
    }

    /// The text encoder asked about a text, by the model's own tokenizer.
    pub fn prompt(source: &ModelSource, prompt: &str, device: &Device) -> Result<Self, ModelError> {
        Ok(Self(Kind::Text(Box::new(TextCall::prompt(
            source, prompt, device,
        )?))))
    }

    /// Runs the part on its inputs once. Called again it gives the same bits.
    pub fn forward(&self) -> Outputs {
        match &self.0 {
            Kind::Unet(call) => call.forward(),
            Kind::Vae(call) => call.forward(),
            Kind::Text(call) => call.forward(),
        }
    }

    /// One forward and one backward pass: the output, `loss`, `grad.sample`, and `grad.` and its
    /// name for each LoRA tensor. Nothing where no gradients were asked for.
    pub fn gradients(&self) -> Option<Outputs> {
        match &self.0 {
            Kind::Unet(call) => call.gradients(),
            Kind::Vae(_) | Kind::Text(_) => None,
        }
    }
}

/// The tensor `name` of the shape that the pattern says; `None` in it fits any extent from 1 on.
fn real(
    inputs: &TensorFile,
    name: &str,
    pattern: &[Option<usize>],
    device: &Device,
) -> Result<Array, ModelError> {
    let array = array(inputs, name, device)?;
    let fits = |(extent, wanted): (&usize, &Option<usize>)| {
        *extent > 0 && wanted.is_none_or(|wanted| wanted == *extent)
    };
    if array.shape().len() == pattern.len() && array.shape().iter().zip(pattern).all(fits) {
        return Ok(array);
    }
    let wanted: Vec<String> = pattern
        .iter()
        .map(|extent| extent.map_or("*".into(), |extent| extent.to_string()))
        .collect();
    Err(inputs
        .wrong(
            name,
            format!(
                "has the shape {:?}; expected [{}]",
                array.shape(),
                wanted.join(", ")
            ),
        )
        .into())
}

/// The whole numbers `name`, each below `limit`.
fn whole(
    inputs: &TensorFile,
    name: &str,
    limit: u32,
) -> Result<(Vec<usize>, Vec<u32>), TensorError> {
    // Files are foreign: a label beyond the table of classes would be looked up out of bounds.
    let (shape, values) = inputs.whole(name)?;
    let number = |value: i64| {
        let problem = || {
            inputs.wrong(
                name,
                format!("has the value {value}; expected are 0 to {}", limit - 1),
            )
        };
        u32::try_from(value)
            .ok()
            .filter(|value| *value < limit)
            .ok_or_else(problem)
    };
    Ok((
        shape,
        values.into_iter().map(number).collect::<Result<_, _>>()?,
    ))
}

/// One whole number for each of `count` samples; a single one stands for all.
fn each(inputs: &TensorFile, name: &str, limit: u32, count: usize) -> Result<Vec<u32>, ModelError> {
    let (shape, values) = whole(inputs, name, limit)?;
    match values[..] {
        // As in diffusers, where one timestep stands for a whole batch.
        [value] => Ok(vec![value; count]),
        _ if values.len() == count && shape.len() == 1 => Ok(values),
        _ => Err(inputs
            .wrong(name, format!("has the shape {shape:?}; expected [{count}]"))
            .into()),
    }
}
