//! `Transformer2DModel` of diffusers: normalised image tokens through blocks of two attentions and
//! a gated feed-forward layer, added to the image.

use std::collections::BTreeMap;

use compute::Array;
use compute::activation::{geglu, geglu_backward};
use compute::elementwise::add;
use compute::norm::Activation;
use compute::shape::{nchw_to_tokens, tokens_to_nchw};

use super::attention::{Attention, AttentionTape};
use super::conv::size;
use super::{GroupNorm, LayerNorm, Linear};
use crate::error::ModelError;
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::unet::TextContext;
use crate::weights::Scope;

/// The sizes of one transformer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TransformerShape {
    pub channels: usize,
    pub heads: usize,
    pub blocks: usize,
    /// Width of the text states.
    pub text: usize,
    /// Whether the first attention of a block, too, looks at the text.
    pub only_cross_attention: bool,
    pub groups: usize,
}

/// A transformer over the pixels of an image.
pub(crate) struct Transformer {
    norm: GroupNorm,
    proj_in: Linear,
    blocks: Vec<Block>,
    proj_out: Linear,
}

/// What the backward pass needs.
pub(crate) struct TransformerTape {
    x: Array,
    blocks: Vec<BlockTape>,
}

struct Block {
    norms: [LayerNorm; 3],
    attentions: [Attention; 2],
    expand: Linear,
    contract: Linear,
}

struct BlockTape {
    /// The inputs of the three normalisations.
    inputs: [Array; 3],
    attentions: [AttentionTape; 2],
    /// Values and gates of the feed-forward layer.
    expanded: Array,
}

impl TransformerTape {
    /// The input `[N, C, H, W]`, from which the tape can be computed once more.
    pub fn input(&self) -> &Array {
        &self.x
    }

    /// The bytes that it holds beside the input.
    pub fn bytes(&self) -> usize {
        self.blocks.iter().map(BlockTape::bytes).sum()
    }
}

impl BlockTape {
    fn bytes(&self) -> usize {
        let arrays = self.inputs.iter().chain([&self.expanded]);
        4 * arrays.map(Array::len).sum::<usize>()
            + self
                .attentions
                .iter()
                .map(AttentionTape::bytes)
                .sum::<usize>()
    }
}

impl Transformer {
    pub fn read(scope: &Scope, shape: &TransformerShape) -> Result<Self, ModelError> {
        let c = shape.channels;
        let block = |i| Block::read(&scope.at(format!("transformer_blocks.{i}")), shape);
        Ok(Self {
            // diffusers fixes this 1e-6 and the layer norms' 1e-5 in its code; no configuration has
            // them.
            norm: GroupNorm::read(&scope.at("norm"), c, shape.groups, 1e-6, Activation::None)?,
            // On tokens, a 1x1 convolution and a linear layer are one and the same.
            proj_in: Linear::read(&scope.at("proj_in"), c, c)?,
            blocks: (0..shape.blocks).map(block).collect::<Result<_, _>>()?,
            proj_out: Linear::read(&scope.at("proj_out"), c, c)?,
        })
    }

    pub fn sites(&self) -> impl Iterator<Item = &AdapterSite> {
        self.blocks
            .iter()
            .flat_map(|block| &block.attentions)
            .flat_map(Attention::sites)
    }

    /// Puts the frozen keys and values of the text states `[P, S, D]` into `projected`, by the
    /// attentions' names.
    pub fn project_text(&self, states: &Array, projected: &mut BTreeMap<String, [Array; 2]>) {
        let attentions = self.blocks.iter().flat_map(|block| &block.attentions);
        attentions.for_each(|attention| attention.project_text(states, projected));
    }

    /// Image `x [N, C, H, W]`.
    pub fn forward(
        &self,
        x: &Array,
        text: &TextContext,
        lora: Option<&LoraNetwork>,
    ) -> (Array, TransformerTape) {
        // [N, H W, C]: each pixel is a token.
        let mut tokens = self.proj_in.forward(&nchw_to_tokens(&self.norm.forward(x)));
        let mut blocks = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let (y, tape) = block.forward(&tokens, text, lora);
            tokens = y;
            blocks.push(tape);
        }
        let [height, width] = size(x);
        let y = add(
            x,
            &tokens_to_nchw(&self.proj_out.forward(&tokens), height, width),
        );
        (
            y,
            TransformerTape {
                x: x.clone(),
                blocks,
            },
        )
    }

    /// The gradient by `x`, if `input` asks for it.
    pub fn backward(
        &self,
        tape: TransformerTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
        input: bool,
    ) -> Option<Array> {
        // The frozen layers need nothing but their weights here, so that no input of theirs is
        // kept.
        let mut d = self.proj_out.backward(&nchw_to_tokens(dy));
        for (block, tape) in self.blocks.iter().zip(tape.blocks).rev() {
            d = block.backward(&tape, &d, lora, gradients);
        }
        let [height, width] = size(dy);
        input.then(|| {
            let normalised = tokens_to_nchw(&self.proj_in.backward(&d), height, width);
            add(dy, &self.norm.backward(&tape.x, &normalised))
        })
    }
}

impl Block {
    fn read(scope: &Scope, shape: &TransformerShape) -> Result<Self, ModelError> {
        let c = shape.channels;
        let norm = |i| LayerNorm::read(&scope.at(format!("norm{i}")), c, 1e-5);
        let attention =
            |i, text| Attention::read(&scope.at(format!("attn{i}")), c, text, shape.heads);
        Ok(Self {
            norms: [norm(1)?, norm(2)?, norm(3)?],
            attentions: [
                attention(1, shape.only_cross_attention.then_some(shape.text))?,
                attention(2, Some(shape.text))?,
            ],
            // 4 c values and 4 c gates.
            expand: Linear::read(&scope.at("ff.net.0.proj"), c, 8 * c)?,
            contract: Linear::read(&scope.at("ff.net.2"), 4 * c, c)?,
        })
    }

    fn forward(
        &self,
        x: &Array,
        text: &TextContext,
        lora: Option<&LoraNetwork>,
    ) -> (Array, BlockTape) {
        let [norm1, norm2, norm3] = &self.norms;
        let [attention1, attention2] = &self.attentions;
        let (y, tape1) = attention1.forward(&norm1.forward(x), text, lora);
        // The two sums are inputs of the next normalisations, whose backward passes need them.
        let x2 = add(x, &y);
        let (y, tape2) = attention2.forward(&norm2.forward(&x2), text, lora);
        let x3 = add(&x2, &y);
        let expanded = self.expand.forward(&norm3.forward(&x3));
        let y = add(&x3, &self.contract.forward(&geglu(&expanded)));
        (
            y,
            BlockTape {
                inputs: [x.clone(), x2, x3],
                attentions: [tape1, tape2],
                expanded,
            },
        )
    }

    fn backward(
        &self,
        tape: &BlockTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Array {
        let expanded = geglu_backward(&tape.expanded, &self.contract.backward(dy));
        let mut d = add(
            dy,
            &self.norms[2].backward(&tape.inputs[2], &self.expand.backward(&expanded)),
        );
        // Each attention stands beside a shortcut, whose gradient is `d` itself.
        for i in [1, 0] {
            let normalised = self.attentions[i].backward(&tape.attentions[i], &d, lora, gradients);
            d = add(&d, &self.norms[i].backward(&tape.inputs[i], &normalised));
        }
        d
    }
}
