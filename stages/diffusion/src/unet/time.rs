//! The embedding of the timestep, to which those of the class and of the camera are added.

use std::collections::BTreeMap;

use compute::activation::{silu, silu_backward};
use compute::elementwise::add;
use compute::linear::{linear, linear_backward_input, linear_backward_weight};
use compute::shape::gather_rows;
use compute::{Array, Device, Weight};

use super::Input;
use crate::config::UnetConfig;
use crate::error::ModelError;
use crate::layers::Linear;
use crate::lora::{CAMERA_1, CAMERA_2, LoraNetwork};
use crate::weights::Scope;

/// Timestep -> sinusoids -> linear -> SiLU -> linear, plus a row of the class table, plus the
/// camera's embedding.
pub(super) struct TimeEmbedding {
    device: Device,
    frequencies: Vec<f32>,
    cosine_first: bool,
    linear_1: Linear,
    linear_2: Linear,
    classes: Option<Weight>,
}

/// What the backward pass needs: the sum before the last activation, and the camera's way through
/// its embedding.
pub(super) struct TimeTape {
    sum: Array,
    camera: Option<CameraTape>,
}

struct CameraTape {
    camera: Array,
    hidden: Array,
}

impl TimeTape {
    pub fn has_camera(&self) -> bool {
        self.camera.is_some()
    }
}

impl TimeEmbedding {
    pub fn read(root: &Scope, config: &UnetConfig) -> Result<Self, ModelError> {
        let first = config.block_out_channels[0];
        // Four times the first block's width is fixed in diffusers' UNet.
        let width = 4 * config.block_out_channels[0];
        let linear_1 = Linear::read(&root.at("time_embedding.linear_1"), first, width)?;
        let class = |count| root.weight("class_embedding.weight", &[count, width]);
        Ok(Self {
            device: linear_1.device().clone(),
            frequencies: frequencies(first / 2, config.freq_shift),
            cosine_first: config.flip_sin_to_cos,
            linear_1,
            linear_2: Linear::read(&root.at("time_embedding.linear_2"), width, width)?,
            classes: config.num_class_embeds.map(class).transpose()?,
        })
    }

    /// Width D of the embedding.
    pub fn width(&self) -> usize {
        self.linear_1.outputs()
    }

    /// The embedding after the activation that every use of it begins with: `[N, D]`.
    pub fn forward(&self, input: &Input) -> (Array, TimeTape) {
        let mut sum = self.linear_2.forward(&silu(
            &self.linear_1.forward(&self.sinusoids(input.timesteps)),
        ));
        if let Some(table) = &self.classes {
            assert_eq!(
                input.class_labels.len(),
                input.timesteps.len(),
                "unet: one class label for each sample"
            );
            sum = add(&sum, &gather_rows(table, input.class_labels));
        }
        let tape = input.lora.zip(input.camera).map(|(lora, camera)| {
            let (embedding, tape) = camera_forward(lora, camera);
            // Added, not put in place of the class: the upscaler was trained with its noise level.
            sum = add(&sum, &embedding);
            tape
        });
        (silu(&sum), TimeTape { sum, camera: tape })
    }

    /// The gradients by the camera embedding's tensors, given that by the result `[N, D]`.
    pub fn backward(
        &self,
        tape: &TimeTape,
        dy: &Array,
        lora: &LoraNetwork,
    ) -> BTreeMap<String, Array> {
        let sum = silu_backward(&tape.sum, dy);
        tape.camera
            .as_ref()
            .map(|tape| camera_backward(lora, tape, &sum))
            .unwrap_or_default()
    }

    /// Sines and cosines of the timesteps in f32, as PyTorch rounds them: `[N, first]`.
    fn sinusoids(&self, timesteps: &[u32]) -> Array {
        let half =
            |t: u32, wave: fn(f32) -> f32| self.frequencies.iter().map(move |f| wave(t as f32 * f));
        let order: [fn(f32) -> f32; 2] = if self.cosine_first {
            [f32::cos, f32::sin]
        } else {
            [f32::sin, f32::cos]
        };
        let values = timesteps
            .iter()
            .flat_map(|&t| half(t, order[0]).chain(half(t, order[1])))
            .collect();
        self.device
            .array(&[timesteps.len(), 2 * self.frequencies.len()], values)
    }
}

/// 10000^(-i / (count - shift)).
fn frequencies(count: usize, shift: f32) -> Vec<f32> {
    // Multiplied before it is divided, all in f32: the roundings of diffusers'
    // `get_timestep_embedding`.
    let exponent = |i| -(10000f64.ln() as f32) * i as f32 / (count as f32 - shift);
    (0..count).map(|i| exponent(i).exp()).collect()
}

fn parameter<'a>(lora: &'a LoraNetwork, layer: &str, kind: &str) -> &'a Array {
    &lora.camera[&format!("{layer}.{kind}")]
}

fn camera_forward(lora: &LoraNetwork, camera: &Array) -> (Array, CameraTape) {
    let hidden = linear(
        camera,
        parameter(lora, CAMERA_1, "weight"),
        Some(parameter(lora, CAMERA_1, "bias")),
    );
    let weight = parameter(lora, CAMERA_2, "weight");
    let y = linear(
        &silu(&hidden),
        weight,
        Some(parameter(lora, CAMERA_2, "bias")),
    );
    (
        y,
        CameraTape {
            camera: camera.clone(),
            hidden,
        },
    )
}

fn camera_backward(lora: &LoraNetwork, tape: &CameraTape, dy: &Array) -> BTreeMap<String, Array> {
    let hidden = silu_backward(
        &tape.hidden,
        &linear_backward_input(dy, parameter(lora, CAMERA_2, "weight")),
    );
    BTreeMap::from([
        (
            format!("{CAMERA_1}.weight"),
            linear_backward_weight(&tape.camera, &hidden),
        ),
        (format!("{CAMERA_1}.bias"), sum_rows(&hidden)),
        (
            format!("{CAMERA_2}.weight"),
            linear_backward_weight(&silu(&tape.hidden), dy),
        ),
        (format!("{CAMERA_2}.bias"), sum_rows(dy)),
    ])
}

/// The gradient of a bias: `[N, D]` summed over N.
fn sum_rows(d: &Array) -> Array {
    let n = d.shape()[0];
    let width = d.shape()[1];
    // A product with ones, since no operator sums over rows.
    linear_backward_weight(&d.device().full(&[n, 1], 1.0), d).reshape(&[width])
}
