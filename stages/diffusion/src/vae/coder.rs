//! Half an autoencoder: the encoder or the decoder, a list of layers between two convolutions.

use compute::Array;
use compute::attention::attention;
use compute::elementwise::add;
use compute::norm::Activation;
use compute::shape::{nchw_to_tokens, tokens_to_nchw};

use super::statistics::{Statistics, TileWalk};
use crate::config::VaeConfig;
use crate::error::ModelError;
use crate::layers::{Conv2d, Downsample, GroupNorm, Linear, Resnet, ResnetShape, Upsample};
use crate::weights::Scope;

// Fixed in the code of diffusers' AutoencoderKL; the UNet's comes from its configuration.
const EPS: f32 = 1e-6;

/// The encoder or the decoder.
pub(super) struct Coder {
    conv_in: Conv2d,
    layers: Vec<Layer>,
    norm_out: GroupNorm,
    conv_out: Conv2d,
}

enum Layer {
    Resnet(Box<Resnet>),
    Attention(Box<Attention>),
    Downsample(Downsample),
    Upsample(Upsample),
}

/// Attention of all pixels to all, with one head.
struct Attention {
    norm: GroupNorm,
    query: Linear,
    key: Linear,
    value: Linear,
    out: Linear,
}

impl Coder {
    /// Image to the posterior's moments: down blocks from the widest image to the narrowest, then
    /// the mid block.
    pub fn encoder(config: &VaeConfig, scope: &Scope) -> Result<Self, ModelError> {
        let widths = &config.block_out_channels;
        let mut stack = Stack {
            config,
            layers: Vec::new(),
            channels: widths[0],
        };
        for (i, &width) in widths.iter().enumerate() {
            let block = scope.at(format!("down_blocks.{i}"));
            stack.resnets(&block, config.layers_per_block, width)?;
            if i + 1 < widths.len() {
                stack.layers.push(Layer::Downsample(Downsample::trailing(
                    &block.at("downsamplers.0"),
                    width,
                )?));
            }
        }
        stack.mid_block(&scope.at("mid_block"))?;
        stack.close(
            scope,
            config.in_channels,
            // Means, and behind them the logarithms of variances.
            2 * config.latent_channels,
            widths[0],
        )
    }

    /// Latent to image: the mid block, then up blocks from the narrowest image to the widest.
    pub fn decoder(config: &VaeConfig, scope: &Scope) -> Result<Self, ModelError> {
        let widths: Vec<usize> = config.block_out_channels.iter().rev().copied().collect();
        let mut stack = Stack {
            config,
            layers: Vec::new(),
            channels: widths[0],
        };
        stack.mid_block(&scope.at("mid_block"))?;
        for (i, &width) in widths.iter().enumerate() {
            let block = scope.at(format!("up_blocks.{i}"));
            // Decoders of diffusers have one ResNet layer more a block than encoders.
            stack.resnets(&block, config.layers_per_block + 1, width)?;
            if i + 1 < widths.len() {
                stack.layers.push(Layer::Upsample(Upsample::read(
                    &block.at("upsamplers.0"),
                    width,
                )?));
            }
        }
        stack.close(
            scope,
            config.latent_channels,
            config.out_channels,
            widths[0],
        )
    }

    pub fn forward(&self, x: &Array, statistics: &mut Statistics) -> Array {
        let mut walk = statistics.walk();
        let x = self
            .layers
            .iter()
            .fold(self.conv_in.forward(x), |x, layer| {
                layer.forward(&x, &mut walk)
            });
        self.conv_out.forward(&walk.normalise(&self.norm_out, &x))
    }
}

impl Layer {
    fn forward(&self, x: &Array, walk: &mut TileWalk) -> Array {
        match self {
            Self::Resnet(resnet) => {
                resnet
                    .forward_by(x, None, |norm, x| walk.normalise(norm, x))
                    .0
            }
            Self::Attention(attention) => attention.forward(x, walk),
            Self::Downsample(downsample) => downsample.forward(x),
            // A decoder knows no size that was halved, so it doubles; what is too much is cropped
            // by `decode_latent`.
            Self::Upsample(upsample) => upsample.forward(x, [2 * x.shape()[2], 2 * x.shape()[3]]),
        }
    }
}

impl Attention {
    fn read(scope: &Scope, channels: usize, groups: usize) -> Result<Self, ModelError> {
        let linear = |name| Linear::read(&scope.at(name), channels, channels);
        Ok(Self {
            norm: GroupNorm::read(
                &scope.at("group_norm"),
                channels,
                groups,
                EPS,
                Activation::None,
            )?,
            query: linear("to_q")?,
            key: linear("to_k")?,
            value: linear("to_v")?,
            out: linear("to_out.0")?,
        })
    }

    fn forward(&self, x: &Array, walk: &mut TileWalk) -> Array {
        let tokens = nchw_to_tokens(&walk.normalise(&self.norm, x));
        let [q, k, v] = [&self.query, &self.key, &self.value].map(|layer| layer.forward(&tokens));
        // Not causal, and one head as wide as the image.
        let attended = attention(&q, &k, &v, 1, false).out;
        add(
            x,
            &tokens_to_nchw(&self.out.forward(&attended), x.shape()[2], x.shape()[3]),
        )
    }
}

/// The layers read so far.
struct Stack<'a> {
    config: &'a VaeConfig,
    layers: Vec<Layer>,
    channels: usize,
}

impl Stack<'_> {
    fn resnets(&mut self, scope: &Scope, count: usize, outputs: usize) -> Result<(), ModelError> {
        for i in 0..count {
            self.resnet(&scope.at(format!("resnets.{i}")), outputs)?;
        }
        Ok(())
    }

    fn resnet(&mut self, scope: &Scope, outputs: usize) -> Result<(), ModelError> {
        let groups = self.config.norm_num_groups;
        let shape = ResnetShape {
            inputs: self.channels,
            outputs,
            time: None,
            groups,
            eps: EPS,
        };
        self.layers
            .push(Layer::Resnet(Box::new(Resnet::read(scope, &shape)?)));
        self.channels = outputs;
        Ok(())
    }

    fn mid_block(&mut self, scope: &Scope) -> Result<(), ModelError> {
        self.resnet(&scope.at("resnets.0"), self.channels)?;
        if self.config.mid_block_add_attention {
            let attention = Attention::read(
                &scope.at("attentions.0"),
                self.channels,
                self.config.norm_num_groups,
            )?;
            self.layers.push(Layer::Attention(Box::new(attention)));
        }
        self.resnet(&scope.at("resnets.1"), self.channels)
    }

    /// With the two convolutions around the layers, the first of which gives `first` channels.
    fn close(
        self,
        scope: &Scope,
        inputs: usize,
        outputs: usize,
        first: usize,
    ) -> Result<Coder, ModelError> {
        let last = self.channels;
        let groups = self.config.norm_num_groups;
        Ok(Coder {
            conv_in: Conv2d::read(&scope.at("conv_in"), inputs, first)?,
            layers: self.layers,
            norm_out: GroupNorm::read(
                &scope.at("conv_norm_out"),
                last,
                groups,
                EPS,
                Activation::Silu,
            )?,
            conv_out: Conv2d::read(&scope.at("conv_out"), last, outputs)?,
        })
    }
}
