//! The UNet asked about the tensors of a file, with or without a LoRA and its gradients.

use std::collections::BTreeMap;

use compute::elementwise::{scale, sub};
use compute::reduce::mean_square;
use compute::{Array, Device};
use formats::TensorFile;

use super::{Asked, Output, Outputs, each, real};
use crate::error::ModelError;
use crate::lora_file::LoraFile;
use crate::source::ModelSource;
use crate::unet::{Input, Unet};

/// Timesteps beyond this are taken for a mistake.
// Up to here each whole number has an `f32` of its own, which the time embedding computes with.
const MAX_TIMESTEP: u32 = 1 << 24;

/// The UNet and what it is asked.
pub(super) struct UnetCall {
    unet: Unet,
    sample: Array,
    timesteps: Vec<u32>,
    class_labels: Vec<u32>,
    text: Array,
    lora: Option<LoraFile>,
    target: Option<Array>,
    kept: usize,
}

impl UnetCall {
    pub fn new(
        source: &ModelSource,
        inputs: &TensorFile,
        asked: &Asked,
        device: &Device,
    ) -> Result<Self, ModelError> {
        let unet = Unet::load(source, device, asked.precision)?;
        let config = unet.config();
        let sample = real(
            inputs,
            "sample",
            &[None, Some(config.in_channels), None, None],
            device,
        )?;
        let &[n, _, h, w] = sample.shape() else {
            unreachable!("the shape was checked")
        };
        let width = Some(config.cross_attention_dim.of(0));
        let output = [Some(n), Some(config.out_channels), Some(h), Some(w)];
        let labels = |classes| each(inputs, "class_labels", classes as u32, n);
        Ok(Self {
            timesteps: each(inputs, "timestep", MAX_TIMESTEP, n)?,
            class_labels: config
                .num_class_embeds
                .map(labels)
                .transpose()?
                .unwrap_or_default(),
            text: real(
                inputs,
                "encoder_hidden_states",
                &[Some(n), None, width],
                device,
            )?,
            target: asked
                .gradients
                .then(|| real(inputs, "target", &output, device))
                .transpose()?,
            lora: asked
                .lora
                .map(|path| LoraFile::read(path, &unet, device))
                .transpose()?,
            kept: asked.kept,
            sample,
            unet,
        })
    }

    fn input(&self) -> Input<'_> {
        Input {
            sample: &self.sample,
            timesteps: &self.timesteps,
            class_labels: &self.class_labels,
            lora: self.lora.as_ref().map(|lora| &lora.network),
            camera: None,
        }
    }

    pub fn forward(&self) -> Outputs {
        let output = self
            .unet
            .forward(&self.input(), &self.unet.text(&self.text));
        Outputs::from([("sample".into(), Output::Real(output))])
    }

    pub fn gradients(&self) -> Option<Outputs> {
        let target = self.target.as_ref()?;
        let input = self.input();
        let text = self.unet.text(&self.text);
        let (output, tape) = self.unet.forward_train(&input, &text, self.kept);
        let error = sub(&output, target);
        // The derivative of the mean square.
        let dy = scale(&error, 2.0 / error.len() as f32);
        let gradients = self.unet.backward(&input, &text, tape, &dy, true);
        let loss = output.device().array(&[], vec![mean_square(&error)]);
        let mut outputs =
            BTreeMap::from([("sample".to_owned(), output), ("loss".to_owned(), loss)]);
        outputs.extend(
            gradients
                .sample
                .map(|gradient| ("grad.sample".to_owned(), gradient)),
        );
        // Under the names of the LoRA's own file, whose spelling depends on the tool that wrote it.
        let names = self.lora.as_ref().map(|lora| &lora.names);
        let stored = |name: &str| {
            names
                .and_then(|names| names.get(name))
                .map_or(name.to_owned(), Clone::clone)
        };
        outputs.extend(
            gradients
                .adapters
                .into_iter()
                .map(|(name, d)| (format!("grad.{}", stored(&name)), d)),
        );
        Some(
            outputs
                .into_iter()
                .map(|(name, array)| (name, Output::Real(array)))
                .collect(),
        )
    }
}
