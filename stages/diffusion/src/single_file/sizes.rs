//! The configurations of the networks in a single file, as diffusers would write them: from the
//! tensors' names and shapes, and for the rest from what is known.
//!
//! Reads no numbers of tensors.

use formats::TensorFile;
use serde_json::{Value, json};

use super::error::SingleFileError;
use super::known;
use super::names::{Names, prefix};
use crate::network::Network;

/// The shapes of one network.
struct Shapes<'a> {
    file: &'a TensorFile,
    names: Names,
}

impl Shapes<'_> {
    /// The extent of an axis of the tensor that diffusers calls `name`.
    fn extent(&self, name: &str, axis: usize) -> Result<usize, SingleFileError> {
        let stored = self.names.stored(name).name;
        let network = self.names.network();
        let file = self.file.name();
        let Ok(entry) = self.file.entry(&stored) else {
            return Err(SingleFileError::missing(file, network, &stored, name));
        };
        let shape = entry.shape();
        let misshapen = || SingleFileError::shape(file, network, &stored, name, shape, "more axes");
        shape.get(axis).copied().ok_or_else(misshapen)
    }
}

/// The names of a network in `file`.
pub(super) fn names(file: &TensorFile, network: Network) -> Result<Names, SingleFileError> {
    match network {
        Network::Unet => Ok(unet_names(file)),
        Network::Vae => Ok(vae_names(file)),
        Network::TextEncoder => text_names(file),
    }
}

/// The configuration of a network in `file`.
pub(super) fn config(file: &TensorFile, network: Network) -> Result<Value, SingleFileError> {
    let names = names(file, network)?;
    let shapes = Shapes { file, names };
    match names {
        Names::Unet { resnets } => unet(&shapes, resnets),
        Names::Vae { blocks } => vae(&shapes, blocks),
        Names::Text { layers } => text(&shapes, layers),
    }
}

/// Whether a network has tensors at a place. One is enough: another that is missing there is named
/// when it is asked for.
fn is_there(file: &TensorFile, network: Network, place: &str) -> bool {
    // With the dot at its end, so that place 1 is not found in place 10.
    let place = format!("{}{place}.", prefix(network));
    file.names().any(|name| name.starts_with(&place))
}

/// No network of this kind has more blocks or layers; a damaged file may.
const MOST: usize = 64;

/// How many of the places that `place` gives for 0, 1, 2.. there are.
fn count(file: &TensorFile, network: Network, place: impl Fn(usize) -> String) -> usize {
    (0..MOST)
        .take_while(|i| is_there(file, network, &place(*i)))
        .count()
}

/// Behind the first convolution lie the ResNet layers of the first block, up to what halves the
/// image.
fn unet_names(file: &TensorFile) -> Names {
    let is_there = |place: &str| is_there(file, Network::Unet, place);
    let is_resnet = |i: &usize| {
        is_there(&format!("input_blocks.{i}.0")) && !is_there(&format!("input_blocks.{i}.0.op"))
    };
    Names::Unet {
        resnets: (1..MOST).take_while(is_resnet).count(),
    }
}

fn vae_names(file: &TensorFile) -> Names {
    Names::Vae {
        blocks: count(file, Network::Vae, |i| format!("encoder.down.{i}")),
    }
}

fn text_names(file: &TensorFile) -> Result<Names, SingleFileError> {
    let names = Names::Text { layers: 0 };
    let layer = |i| format!("transformer.resblocks.{i}");
    let stored = count(file, Network::TextEncoder, layer);
    let width = Shapes { file, names }.extent("text_model.embeddings.token_embedding.weight", 1)?;
    Ok(Names::Text {
        layers: known::text_layers(width, stored),
    })
}

fn unet(shapes: &Shapes, resnets: usize) -> Result<Value, SingleFileError> {
    let blocks = Blocks::of(shapes, resnets)?;
    let sizes = json!({
        "in_channels": shapes.extent("conv_in.weight", 1)?,
        "out_channels": shapes.extent("conv_out.weight", 0)?,
        "block_out_channels": blocks.each(Blocks::channels)?,
        "layers_per_block": resnets,
        "down_block_types": blocks.types("DownBlock2D", "CrossAttnDownBlock2D"),
        "up_block_types": blocks.types("UpBlock2D", "CrossAttnUpBlock2D").into_iter().rev().collect::<Vec<_>>(),
        "only_cross_attention": blocks.each(Blocks::looks_at_text_only)?,
        "cross_attention_dim": blocks.text,
        "num_class_embeds": shapes.extent("class_embedding.weight", 0)?,
    });
    Ok(joined(sizes, known::unet()))
}

/// The down blocks of a UNet, whose up blocks mirror them.
struct Blocks<'a> {
    shapes: &'a Shapes<'a>,
    resnets: usize,
    count: usize,
    /// Width of the text states.
    text: usize,
}

impl<'a> Blocks<'a> {
    /// There is one more than there are places that halve the image.
    fn of(shapes: &'a Shapes, resnets: usize) -> Result<Self, SingleFileError> {
        let halved = |i| format!("input_blocks.{}.0.op", (i + 1) * (resnets + 1));
        let keys = "mid_block.attentions.0.transformer_blocks.0.attn2.to_k.weight";
        Ok(Self {
            shapes,
            resnets,
            count: 1 + count(shapes.file, Network::Unet, halved),
            text: shapes.extent(keys, 1)?,
        })
    }

    fn each<T>(
        &self,
        of: impl Fn(&Self, usize) -> Result<T, SingleFileError>,
    ) -> Result<Vec<T>, SingleFileError> {
        (0..self.count).map(|block| of(self, block)).collect()
    }

    fn types(&self, plain: &'static str, attending: &'static str) -> Vec<&'static str> {
        let of = |block| {
            if self.attends(block) {
                attending
            } else {
                plain
            }
        };
        (0..self.count).map(of).collect()
    }

    fn channels(&self, block: usize) -> Result<usize, SingleFileError> {
        let name = format!("down_blocks.{block}.resnets.0.conv2.weight");
        self.shapes.extent(&name, 0)
    }

    /// Whether a block has attentions.
    fn attends(&self, block: usize) -> bool {
        let first = 1 + block * (self.resnets + 1);
        is_there(
            self.shapes.file,
            Network::Unet,
            &format!("input_blocks.{first}.1"),
        )
    }

    /// Whether the first attention of a block, too, looks at the text, and none at the image.
    fn looks_at_text_only(&self, block: usize) -> Result<bool, SingleFileError> {
        if !self.attends(block) {
            return Ok(false);
        }
        let keys =
            format!("down_blocks.{block}.attentions.0.transformer_blocks.0.attn1.to_k.weight");
        let seen = self.shapes.extent(&keys, 1)?;
        // Where image and text are equally wide, the keys' shape fits both, and only what is known
        // decides.
        let only_one_fits = seen != self.channels(block)?;
        Ok(seen == self.text && (only_one_fits || known::looks_at_text(block, self.count)))
    }
}

fn vae(shapes: &Shapes, blocks: usize) -> Result<Value, SingleFileError> {
    let resnet = |i| format!("encoder.down.0.block.{i}");
    let resnets = count(shapes.file, Network::Vae, resnet);
    let channel = |i| {
        let name = format!("encoder.down_blocks.{i}.resnets.0.conv1.weight");
        shapes.extent(&name, 0)
    };
    let sizes = json!({
        "in_channels": shapes.extent("encoder.conv_in.weight", 1)?,
        "out_channels": shapes.extent("decoder.conv_out.weight", 0)?,
        "block_out_channels": (0..blocks).map(channel).collect::<Result<Vec<_>, _>>()?,
        "layers_per_block": resnets,
        "latent_channels": shapes.extent("decoder.conv_in.weight", 1)?,
        "down_block_types": vec!["DownEncoderBlock2D"; blocks],
        "up_block_types": vec!["UpDecoderBlock2D"; blocks],
    });
    Ok(joined(sizes, known::vae()))
}

fn text(shapes: &Shapes, layers: usize) -> Result<Value, SingleFileError> {
    let width = shapes.extent("text_model.embeddings.token_embedding.weight", 1)?;
    let sizes = json!({
        "vocab_size": shapes.extent("text_model.embeddings.token_embedding.weight", 0)?,
        "hidden_size": width,
        "intermediate_size": shapes.extent("text_model.encoder.layers.0.mlp.fc1.weight", 0)?,
        "num_hidden_layers": layers,
        "max_position_embeddings": shapes.extent("text_model.embeddings.position_embedding.weight", 0)?,
    });
    Ok(joined(sizes, known::text(width)))
}

/// The fields of both.
fn joined(mut sizes: Value, known: Value) -> Value {
    if let (Value::Object(sizes), Value::Object(known)) = (&mut sizes, known) {
        sizes.extend(known);
    }
    sizes
}
