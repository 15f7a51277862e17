//! `UNet2DConditionModel` of diffusers, as its configuration says, with LoRA training: gradients by the adapters, the camera
//! embedding and the input. The frozen weights get none.
//!
//! The network is one list of layers and a stack of skip connections, walked forwards and backwards. Knows no noise schedule.

mod layer;
mod plan;
mod time;

use compute::elementwise::add;
use compute::norm::Activation;
use compute::{Array, Device};

use crate::config::UnetConfig;
use crate::error::ModelError;
use crate::layers::{Conv2d, GroupNorm};
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::weights::Weights;
use layer::{Layer, LayerTape, Pass, Walk};
use time::{TimeEmbedding, TimeTape};

/// The denoising network.
pub struct Unet {
    config: UnetConfig,
    device: Device,
    time: TimeEmbedding,
    conv_in: Conv2d,
    layers: Vec<Layer>,
    norm_out: GroupNorm,
    conv_out: Conv2d,
    sites: Vec<AdapterSite>,
}

/// What [`Unet::backward`] needs of a forward pass.
pub struct Tape {
    lora: Option<LoraNetwork>,
    size: [usize; 2],
    time: TimeTape,
    layers: Vec<LayerTape>,
    last: Array,
}

impl Unet {
    /// Reads the network. Fails if the file does not hold exactly the tensors that the configuration asks for.
    pub(crate) fn read(config: UnetConfig, weights: Weights, device: &Device) -> Result<Self, ModelError> {
        let root = weights.root();
        let first = config.block_out_channels[0];
        let norm_out = root.at("conv_norm_out");
        let layers = plan::layers(&config, &root)?;
        let unet = Self {
            time: TimeEmbedding::read(&root, &config)?,
            conv_in: Conv2d::read(&root.at("conv_in"), config.in_channels, first)?,
            norm_out: GroupNorm::read(&norm_out, first, config.norm_num_groups, config.norm_eps, Activation::Silu)?,
            conv_out: Conv2d::read(&root.at("conv_out"), first, config.out_channels)?,
            sites: layers.iter().flat_map(Layer::sites).cloned().collect(),
            layers,
            device: device.clone(),
            config,
        };
        weights.finish(&[])?;
        Ok(unet)
    }

    /// The network's configuration.
    pub fn config(&self) -> &UnetConfig {
        &self.config
    }

    /// Predicts for `sample [N, C, h, w]` (any h and w) at one of `timesteps` each, given `text [N, S, D]` and, if the network
    /// knows classes (the x4 upscaler's noise levels), one of `class_labels` each: `[N, C', h, w]`.
    ///
    /// With `lora`, its adapters take part, and with `camera [N, 16]` its camera embedding, too.
    pub fn forward(
        &self,
        sample: &Array,
        timesteps: &[u32],
        text: &Array,
        class_labels: &[u32],
        lora: Option<&LoraNetwork>,
        camera: Option<&Array>,
    ) -> Array {
        self.walk(sample, timesteps, text, class_labels, lora, camera, drop).0
    }

    /// [`Unet::forward`], and what [`Unet::backward`] needs.
    pub fn forward_train(
        &self,
        sample: &Array,
        timesteps: &[u32],
        text: &Array,
        class_labels: &[u32],
        lora: Option<&LoraNetwork>,
        camera: Option<&Array>,
    ) -> (Array, Tape) {
        let mut layers = Vec::with_capacity(self.layers.len());
        let (y, last, time) = self.walk(sample, timesteps, text, class_labels, lora, camera, |tape| layers.push(tape));
        let size = [sample.shape()[2], sample.shape()[3]];
        (y, Tape { lora: lora.cloned(), size, time, layers, last })
    }

    #[allow(clippy::too_many_arguments)]
    fn walk(
        &self,
        sample: &Array,
        timesteps: &[u32],
        text: &Array,
        class_labels: &[u32],
        lora: Option<&LoraNetwork>,
        camera: Option<&Array>,
        mut keep: impl FnMut(LayerTape),
    ) -> (Array, Array, TimeTape) {
        let (time, time_tape) = self.time.forward(timesteps, class_labels, lora, camera);
        let pass = Pass { time: &time, text, lora };
        let mut walk = Walk { x: self.conv_in.forward(sample), skips: Vec::new() };
        for layer in &self.layers {
            keep(layer.forward(&mut walk, &pass));
        }
        let y = self.conv_out.forward(&self.norm_out.forward(&walk.x));
        (y, walk.x, time_tape)
    }

    /// The gradients of a loss whose gradient by the output is `dy [N, C', h, w]`; that by the input if `sample` asks for it.
    ///
    /// The walk back ends at the first layer that has something to learn.
    pub fn backward(&self, tape: Tape, dy: &Array, sample: bool) -> LoraGradients {
        let lora = tape.lora.as_ref();
        let mut gradients = LoraGradients::default();
        let mut walk = Walk { x: self.backward_head(&tape, dy), skips: Vec::new() };
        let mut time = tape.time.has_camera().then(|| self.device.zeros(tape.time.shape()));
        let first = if sample { Some(0) } else { self.first_trained(lora, time.is_some()) };
        for (i, (layer, kept)) in self.layers.iter().zip(tape.layers).enumerate().rev() {
            if first.is_some_and(|first| i >= first) {
                layer.backward(kept, &mut walk, lora, &mut gradients, &mut time, sample || Some(i) > first);
            }
        }
        if let (Some(lora), Some(time)) = (lora, &time) {
            gradients.camera = self.time.backward(&tape.time, time, lora);
        }
        gradients.sample = sample.then(|| self.conv_in.backward(&walk.x, tape.size));
        gradients
    }

    fn backward_head(&self, tape: &Tape, dy: &Array) -> Array {
        self.norm_out.backward(&tape.last, &self.conv_out.backward(dy, tape.size))
    }

    fn first_trained(&self, lora: Option<&LoraNetwork>, camera: bool) -> Option<usize> {
        self.layers.iter().position(|layer| match layer {
            Layer::Resnet(_) => camera,
            Layer::Transformer(_) => lora.is_some(),
            _ => false,
        })
    }

    /// Untrained adapters of this rank for every attention, with a camera embedding: they change nothing yet.
    pub fn new_lora(&self, rank: usize, alpha: f64, seed: u64) -> LoraNetwork {
        LoraNetwork::new(&self.sites, self.time.width(), rank, alpha, seed, &self.device)
    }

    /// Fails if the tensors are not those of [`Unet::new_lora`] by name and shape; `file`, where they came from, is named.
    pub fn check_lora(&self, lora: &LoraNetwork, file: &str) -> Result<(), ModelError> {
        lora.check(&self.sites, self.time.width(), file)
    }
}

/// Adds to a gradient that may still be none.
fn accumulate(sum: &mut Option<Array>, term: Option<Array>) {
    if let Some(term) = term {
        *sum = Some(sum.as_ref().map_or_else(|| term.clone(), |sum| add(sum, &term)));
    }
}
