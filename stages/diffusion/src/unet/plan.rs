//! From a configuration to the list of the UNet's layers, with their weights.

use super::layer::Layer;
use crate::config::{UnetBlock, UnetConfig};
use crate::error::ModelError;
use crate::layers::{Downsample, Resnet, ResnetShape, Transformer, TransformerShape, Upsample};
use crate::weights::Scope;

/// All layers between the first and the last convolution.
pub(super) fn layers(config: &UnetConfig, root: &Scope) -> Result<Vec<Layer>, ModelError> {
    let mut plan = Plan {
        config,
        // The first convolution's image is a skip as well.
        layers: vec![Layer::Push],
        channels: config.block_out_channels[0],
        skips: Vec::new(),
    };
    plan.skips.push(plan.channels);
    for block in 0..config.block_out_channels.len() {
        plan.down_block(block, &root.at(format!("down_blocks.{block}")))?;
    }
    plan.mid_block(&root.at("mid_block"))?;
    for block in 0..config.block_out_channels.len() {
        plan.up_block(block, &root.at(format!("up_blocks.{block}")))?;
    }
    Ok(plan.layers)
}

struct Plan<'a> {
    config: &'a UnetConfig,
    layers: Vec<Layer>,
    /// Channels of the image at this point.
    channels: usize,
    /// Channels of the images on the stack.
    skips: Vec<usize>,
}

impl Plan<'_> {
    fn last(&self) -> usize {
        self.config.block_out_channels.len() - 1
    }

    fn down_block(&mut self, block: usize, scope: &Scope) -> Result<(), ModelError> {
        for i in 0..self.config.layers_per_block.of(block) {
            self.resnet(
                &scope.at(format!("resnets.{i}")),
                self.config.block_out_channels[block],
            )?;
            if self.config.down_block_types[block] == UnetBlock::CrossAttention {
                let only_cross = self.config.only_cross_attention.of(block);
                self.transformer(&scope.at(format!("attentions.{i}")), block, only_cross)?;
            }
            self.push();
        }
        if block < self.last() {
            self.layers.push(Layer::Downsample(Downsample::centred(
                &scope.at("downsamplers.0"),
                self.channels,
            )?));
            self.push();
        }
        Ok(())
    }

    fn mid_block(&mut self, scope: &Scope) -> Result<(), ModelError> {
        self.resnet(&scope.at("resnets.0"), self.channels)?;
        // The middle keeps its self-attention, whatever `only_cross_attention` says of the blocks.
        self.transformer(&scope.at("attentions.0"), self.last(), false)?;
        self.resnet(&scope.at("resnets.1"), self.channels)
    }

    /// Up blocks undo the down blocks in reverse order, but their types are listed in their own.
    fn up_block(&mut self, index: usize, scope: &Scope) -> Result<(), ModelError> {
        let block = self.last() - index;
        // One layer more than on the way down: it takes the skip of the downsampling before the
        // block, or of the first convolution.
        for i in 0..=self.config.layers_per_block.of(block) {
            self.layers.push(Layer::Pop);
            self.channels += self.skips.pop().unwrap_or(0);
            self.resnet(
                &scope.at(format!("resnets.{i}")),
                self.config.block_out_channels[block],
            )?;
            if self.config.up_block_types[index] == UnetBlock::CrossAttention {
                let only_cross = self.config.only_cross_attention.of(block);
                self.transformer(&scope.at(format!("attentions.{i}")), block, only_cross)?;
            }
        }
        if index < self.last() {
            self.layers.push(Layer::Upsample(Upsample::read(
                &scope.at("upsamplers.0"),
                self.channels,
            )?));
        }
        Ok(())
    }

    fn push(&mut self) {
        self.layers.push(Layer::Push);
        self.skips.push(self.channels);
    }

    fn resnet(&mut self, scope: &Scope, outputs: usize) -> Result<(), ModelError> {
        let shape = ResnetShape {
            inputs: self.channels,
            outputs,
            // The time embedding is four times as wide as the first block, in all of diffusers'
            // UNets.
            time: Some(4 * self.config.block_out_channels[0]),
            groups: self.config.norm_num_groups,
            eps: self.config.norm_eps,
        };
        self.layers
            .push(Layer::Resnet(Box::new(Resnet::read(scope, &shape)?)));
        self.channels = outputs;
        Ok(())
    }

    fn transformer(
        &mut self,
        scope: &Scope,
        block: usize,
        only_cross_attention: bool,
    ) -> Result<(), ModelError> {
        let shape = TransformerShape {
            channels: self.channels,
            // The number of heads, in spite of its name in diffusers.
            heads: self.config.attention_head_dim.of(block),
            blocks: self.config.transformer_layers_per_block.of(block),
            text: self.config.cross_attention_dim.of(block),
            only_cross_attention,
            groups: self.config.norm_num_groups,
        };
        self.layers
            .push(Layer::Transformer(Box::new(Transformer::read(
                scope, &shape,
            )?)));
        Ok(())
    }
}
