//! `UNet2DConditionModel` of diffusers, as its configuration says, with LoRA training: gradients by
//! the adapters, the camera embedding and the input. The frozen weights get none.
//!
//! The network is one list of layers and a stack of skip connections, walked forwards and
//! backwards. Knows no noise schedule.

mod layer;
mod plan;
mod tape;
mod text;
mod time;

use std::collections::BTreeMap;

use compute::elementwise::add;
use compute::norm::Activation;
use compute::{Array, Device, Precision};

use crate::config::UnetConfig;
use crate::error::ModelError;
use crate::layers::{Conv2d, GroupNorm};
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::network::Network;
use crate::source::ModelSource;
use crate::weights::Weights;
use layer::{Gathered, Layer, Pass, WalkState};
use tape::Kept;
use time::TimeEmbedding;

pub use tape::Tape;
pub use text::TextContext;

/// The UNet of a latent upscaler, which predicts noise or velocities of noised latents.
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

/// What the network is asked about: N samples.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The samples `[N, C, h, w]`, any h and w.
    pub sample: &'a Array,
    /// The timestep of each sample, as many as there are samples.
    pub timesteps: &'a [u32],
    /// One class each, if the network knows classes (the x4 upscaler's noise levels).
    pub class_labels: &'a [u32],
    /// Adapters that take part.
    pub lora: Option<&'a LoraNetwork>,
    /// One camera each, `[N, 16]`, for the LoRA's camera embedding.
    pub camera: Option<&'a Array>,
}

impl Unet {
    /// Reads the network of `source` onto `device`, to multiply in `precision`. The error names the
    /// file, and the field or tensor in it.
    pub fn load(
        source: &ModelSource,
        device: &Device,
        precision: Precision,
    ) -> Result<Self, ModelError> {
        let config = UnetConfig::read(&source.file("unet/config.json")?)?;
        let weights = source.weights(Network::Unet, device)?;
        Self::read(config, weights.with_precision(precision), device)
    }

    /// Reads the network. Fails if the file does not hold exactly the tensors that the
    /// configuration asks for.
    fn read(config: UnetConfig, weights: Weights, device: &Device) -> Result<Self, ModelError> {
        let root = weights.root();
        let first = config.block_out_channels[0];
        let norm_out = root.at("conv_norm_out");
        let layers = plan::layers(&config, &root)?;
        let unet = Self {
            time: TimeEmbedding::read(&root, &config)?,
            conv_in: Conv2d::read(&root.at("conv_in"), config.in_channels, first)?,
            norm_out: GroupNorm::read(
                &norm_out,
                first,
                config.norm_num_groups,
                config.norm_eps,
                Activation::Silu,
            )?,
            conv_out: Conv2d::read(&root.at("conv_out"), first, config.out_channels)?,
            sites: layers.iter().flat_map(Layer::sites).cloned().collect(),
            layers,
            device: device.clone(),
            config,
        };
        weights.finish(&[])?;
        Ok(unet)
    }

    /// What its `config.json` says.
    pub fn config(&self) -> &UnetConfig {
        &self.config
    }

    /// The text states `[P, S, D]` of one text, or of one for each sample, as this network's
    /// attentions see them.
    pub fn text(&self, states: &Array) -> TextContext {
        let mut projected = BTreeMap::new();
        for layer in &self.layers {
            if let Layer::Transformer(transformer) = layer {
                transformer.project_text(states, &mut projected);
            }
        }
        TextContext {
            states: states.clone(),
            projected,
        }
    }

    /// The prediction `[N, C', h, w]`.
    pub fn forward(&self, input: &Input, text: &TextContext) -> Array {
        let (time, _) = self.time.forward(input);
        let mut walk = self.enter(input);
        self.layers
            .iter()
            .for_each(|layer| drop(layer.forward(&mut walk, &Pass::new(&time, text, input))));
        self.leave(&walk.x)
    }

    /// [`Unet::forward`] for each of the texts. What comes before the first attention is computed
    /// once.
    pub fn forward_each(&self, input: &Input, texts: &[&TextContext]) -> Vec<Array> {
        let (time, _) = self.time.forward(input);
        let shared = self
            .layers
            .iter()
            .position(|layer| matches!(layer, Layer::Transformer(_)));
        // Without an attention no layer knows the text. Then nothing is shared, and each text walks
        // all of it.
        let (shared, rest) = self.layers.split_at(shared.unwrap_or(0));
        let mut walk = self.enter(input);
        if let Some(text) = texts.first() {
            shared
                .iter()
                .for_each(|layer| drop(layer.forward(&mut walk, &Pass::new(&time, text, input))));
        }
        let finish = |text: &&TextContext| {
            // Arrays are shared and not copied, so that a clone of the stack costs little.
            let mut walk = walk.clone();
            rest.iter()
                .for_each(|layer| drop(layer.forward(&mut walk, &Pass::new(&time, text, input))));
            self.leave(&walk.x)
        };
        texts.iter().map(finish).collect()
    }

    /// [`Unet::forward`], and what [`Unet::backward`] needs; `budget` is how many bytes that may be
    /// beside the layers' inputs. What does not fit is computed once more on the way back: 0 for
    /// the least memory, `usize::MAX` for the least time.
    pub fn forward_train(&self, input: &Input, text: &TextContext, budget: usize) -> (Array, Tape) {
        let (embedding, time) = self.time.forward(input);
        let mut kept = Kept::new(budget);
        let mut walk = self.enter(input);
        self.layers.iter().for_each(|layer| {
            kept.push(layer.forward(&mut walk, &Pass::new(&embedding, text, input)))
        });
        let size = [input.sample.shape()[2], input.sample.shape()[3]];
        (
            self.leave(&walk.x),
            Tape {
                size,
                time,
                embedding,
                layers: kept.into_layers(),
                last: walk.x,
            },
        )
    }

    fn enter(&self, input: &Input) -> WalkState {
        WalkState {
            x: self.conv_in.forward(input.sample),
            skips: Vec::new(),
        }
    }

    fn leave(&self, x: &Array) -> Array {
        self.conv_out.forward(&self.norm_out.forward(x))
    }

    /// The gradients of a loss whose gradient by the output is `dy [N, C', h, w]`; that by the
    /// sample if `sample` asks for it. `input` and `text` are those of the forward pass.
    ///
    /// The walk back ends at the first layer that has something to learn.
    pub fn backward(
        &self,
        input: &Input,
        text: &TextContext,
        tape: Tape,
        dy: &Array,
        sample: bool,
    ) -> LoraGradients {
        let pass = Pass::new(&tape.embedding, text, input);
        let mut walk = WalkState {
            x: self.backward_head(&tape, dy),
            skips: Vec::new(),
        };
        // The time embedding gets a gradient for the sake of the camera alone: all else in it is
        // frozen.
        let time = tape
            .time
            .has_camera()
            .then(|| self.device.zeros(tape.embedding.shape()));
        let first = if sample {
            Some(0)
        } else {
            self.first_trained(input.lora, time.is_some())
        };
        let mut gathered = Gathered {
            lora: LoraGradients::default(),
            time,
        };
        // Tapes are handed over one by one and dropped when they are used: memory falls along the
        // way.
        for (i, (layer, kept)) in self.layers.iter().zip(tape.layers).enumerate().rev() {
            if first.is_some_and(|first| i >= first) {
                layer.backward(
                    kept,
                    &mut walk,
                    &pass,
                    &mut gathered,
                    // The first layer that learns need not pass its gradient on.
                    sample || Some(i) > first,
                );
            }
        }
        let mut gradients = gathered.lora;
        if let (Some(lora), Some(time)) = (input.lora, &gathered.time) {
            gradients.camera = self.time.backward(&tape.time, time, lora);
        }
        // [N, C, h, w], with the channels of the low-resolution image.
        gradients.sample = sample.then(|| self.conv_in.backward(&walk.x, tape.size));
        gradients
    }

    fn backward_head(&self, tape: &Tape, dy: &Array) -> Array {
        self.norm_out
            .backward(&tape.last, &self.conv_out.backward(dy, tape.size))
    }

    fn first_trained(&self, lora: Option<&LoraNetwork>, camera: bool) -> Option<usize> {
        self.layers.iter().position(|layer| match layer {
            // Frozen itself, but the camera reaches it through the time embedding.
            Layer::Resnet(_) => camera,
            Layer::Transformer(_) => lora.is_some(),
            _ => false,
        })
    }

    /// Untrained adapters of this rank for every attention, with a camera embedding: they change
    /// nothing yet.
    pub fn new_lora(&self, rank: usize, alpha: f64, seed: u64) -> LoraNetwork {
        LoraNetwork::new(
            &self.sites,
            self.time.width(),
            rank,
            alpha,
            seed,
            &self.device,
        )
    }

    /// The layers that a LoRA may adapt, by their paths.
    pub(crate) fn adapted_layers(&self) -> impl Iterator<Item = &str> {
        self.sites.iter().filter_map(AdapterSite::layer)
    }

    /// Fails if a tensor is none of [`Unet::new_lora`] by name and shape, or lacks its partner;
    /// `file`, where they came from, is named.
    pub fn check_lora(&self, lora: &LoraNetwork, file: &str) -> Result<(), ModelError> {
        lora.check(&self.sites, self.time.width(), file)
    }
}

/// Adds to a gradient that may still be none.
fn accumulate(sum: &mut Option<Array>, term: Option<Array>) {
    if let Some(term) = term {
        *sum = Some(
            sum.as_ref()
                .map_or_else(|| term.clone(), |sum| add(sum, &term)),
        );
    }
}
