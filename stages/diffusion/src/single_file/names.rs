//! What the single file calls the tensors that diffusers names: latent diffusion's `UNetModel` and
//! `AutoencoderKL`, and OpenCLIP's text transformer.
//!
//! Knows how either counts blocks and layers; not which tensors a file holds, nor their shapes.

use crate::network::Network;
use crate::stored::Stored;

/// The names of one network.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Names {
    /// A UNet of so many ResNet layers in each down block.
    Unet { resnets: usize },
    /// An autoencoder of so many blocks on either side.
    Vae { blocks: usize },
    /// A text encoder that gives what stands behind so many layers.
    Text { layers: usize },
}

impl Names {
    pub fn network(self) -> Network {
        match self {
            Self::Unet { .. } => Network::Unet,
            Self::Vae { .. } => Network::Vae,
            Self::Text { .. } => Network::TextEncoder,
        }
    }

    /// The tensor that diffusers calls `name`. What has no counterpart keeps its name.
    pub fn stored(self, name: &str) -> Stored {
        let parts: Vec<&str> = name.split('.').collect();
        let own = match self {
            Self::Unet { resnets } => unet(&parts, resnets),
            Self::Vae { blocks } => vae(&parts, blocks),
            Self::Text { .. } => text(parts.strip_prefix(&["text_model"]).unwrap_or(&parts)),
        };
        let own = own.unwrap_or_else(|| name.to_owned());
        Stored {
            name: format!("{}{own}", prefix(self.network())),
            third: third(&parts).filter(|_| own.contains(".in_proj_")),
        }
    }

    /// Whether the file's tensor `stored` belongs to this network, and has a say in what it gives.
    pub fn takes(self, stored: &str) -> bool {
        let Some(own) = stored.strip_prefix(prefix(self.network())) else {
            return false;
        };
        match self {
            Self::Text { layers } => {
                let behind = format!("transformer.resblocks.{layers}.");
                let idle = ["text_projection", "logit_scale", "attn_mask"];
                !own.starts_with(&behind) && !idle.contains(&own)
            }
            _ => true,
        }
    }
}

/// What stands before all names of a network.
pub(super) fn prefix(network: Network) -> &'static str {
    match network {
        Network::Unet => "model.diffusion_model.",
        Network::Vae => "first_stage_model.",
        Network::TextEncoder => "cond_stage_model.model.",
    }
}

/// The UNet counts through all blocks: first an image's convolution, then for each block its layers
/// and the change of size behind them.
fn unet(parts: &[&str], resnets: usize) -> Option<String> {
    // Each block takes `resnets` + 1 places: the last of them halves on the way down, and is one
    // ResNet layer more on the way up.
    let at = |block: &str, layer: usize| Some(number(block)? * (resnets + 1) + layer);
    let place = match *parts {
        ["conv_in", end] => format!("input_blocks.0.0.{end}"),
        ["time_embedding", "linear_1", end] => format!("time_embed.0.{end}"),
        ["time_embedding", "linear_2", end] => format!("time_embed.2.{end}"),
        ["class_embedding", end] => format!("label_emb.{end}"),
        ["conv_norm_out", end] => format!("out.0.{end}"),
        ["conv_out", end] => format!("out.2.{end}"),
        ["down_blocks", block, "downsamplers", "0", "conv", end] => {
            // Place 0 is the image's convolution, so that all places on the way down are one
            // further on.
            format!("input_blocks.{}.0.op.{end}", at(block, resnets + 1)?)
        }
        ["up_blocks", block, "upsamplers", "0", "conv", end] => {
            // 2, behind a ResNet layer and a transformer: the upscaler's only up block without
            // transformers is the last, which does not enlarge.
            format!("output_blocks.{}.2.conv.{end}", at(block, resnets)?)
        }
        // Behind the arm of `downsamplers`, which this pattern fits as well.
        ["down_blocks", block, kind, i, ref rest @ ..] => {
            let place = at(block, 1 + number(i)?)?;
            format!("input_blocks.{place}.{}", unet_layer(kind, rest)?)
        }
        ["up_blocks", block, kind, i, ref rest @ ..] => {
            let place = at(block, number(i)?)?;
            format!("output_blocks.{place}.{}", unet_layer(kind, rest)?)
        }
        ["mid_block", "attentions", "0", ref rest @ ..] => {
            format!("middle_block.1.{}", rest.join("."))
        }
        ["mid_block", "resnets", i, ref rest @ ..] => {
            format!("middle_block.{}.{}", 2 * number(i)?, unet_resnet(rest)?)
        }
        _ => return None,
    };
    Some(place)
}

/// A layer of a block: a ResNet's comes first, a transformer's second, under diffusers' own names.
fn unet_layer(kind: &str, rest: &[&str]) -> Option<String> {
    match kind {
        "resnets" => Some(format!("0.{}", unet_resnet(rest)?)),
        "attentions" => Some(format!("1.{}", rest.join("."))),
        _ => None,
    }
}

fn unet_resnet(rest: &[&str]) -> Option<String> {
    let [layer, end] = rest else { return None };
    let layer = match *layer {
        "norm1" => "in_layers.0",
        "conv1" => "in_layers.2",
        "time_emb_proj" => "emb_layers.1",
        "norm2" => "out_layers.0",
        "conv2" => "out_layers.3",
        "conv_shortcut" => "skip_connection",
        _ => return None,
    };
    Some(format!("{layer}.{end}"))
}

/// The autoencoder counts up blocks from the one of full size, the last in diffusers.
fn vae(parts: &[&str], blocks: usize) -> Option<String> {
    let mirrored = |block: &str| (blocks.checked_sub(1)?).checked_sub(number(block)?);
    let place = match *parts {
        [side, "conv_norm_out", end] => format!("{side}.norm_out.{end}"),
        [side, "mid_block", "resnets", i, ref rest @ ..] => {
            format!("{side}.mid.block_{}.{}", number(i)? + 1, vae_resnet(rest))
        }
        [side, "mid_block", "attentions", "0", ref rest @ ..] => {
            format!("{side}.mid.attn_1.{}", vae_attention(rest)?)
        }
        [side, "down_blocks", block, "resnets", i, ref rest @ ..] => {
            format!("{side}.down.{block}.block.{i}.{}", vae_resnet(rest))
        }
        [side, "down_blocks", block, "downsamplers", "0", "conv", end] => {
            format!("{side}.down.{block}.downsample.conv.{end}")
        }
        [side, "up_blocks", block, "resnets", i, ref rest @ ..] => {
            let block = mirrored(block)?;
            format!("{side}.up.{block}.block.{i}.{}", vae_resnet(rest))
        }
        [side, "up_blocks", block, "upsamplers", "0", "conv", end] => {
            format!("{side}.up.{}.upsample.conv.{end}", mirrored(block)?)
        }
        _ => return None,
    };
    Some(place)
}

fn vae_resnet(rest: &[&str]) -> String {
    rest.join(".").replace("conv_shortcut", "nin_shortcut")
}

fn vae_attention(rest: &[&str]) -> Option<String> {
    let own = match *rest {
        ["group_norm", end] => format!("norm.{end}"),
        ["to_q", end] => format!("q.{end}"),
        ["to_k", end] => format!("k.{end}"),
        ["to_v", end] => format!("v.{end}"),
        ["to_out", "0", end] => format!("proj_out.{end}"),
        _ => return None,
    };
    Some(own)
}

/// OpenCLIP keeps the projections to queries, keys and values in one tensor, in this order.
fn text(parts: &[&str]) -> Option<String> {
    let place = match *parts {
        ["embeddings", "token_embedding", "weight"] => "token_embedding.weight".to_owned(),
        ["embeddings", "position_embedding", "weight"] => "positional_embedding".to_owned(),
        ["final_layer_norm", end] => format!("ln_final.{end}"),
        ["encoder", "layers", i, ref rest @ ..] => {
            let layer = match *rest {
                ["layer_norm1", end] => format!("ln_1.{end}"),
                ["layer_norm2", end] => format!("ln_2.{end}"),
                ["mlp", "fc1", end] => format!("mlp.c_fc.{end}"),
                ["mlp", "fc2", end] => format!("mlp.c_proj.{end}"),
                ["self_attn", "out_proj", end] => format!("attn.out_proj.{end}"),
                // All three projections lead here; `third` says which part of the rows is meant.
                ["self_attn", _, end] => format!("attn.in_proj_{end}"),
                _ => return None,
            };
            format!("transformer.resblocks.{i}.{layer}")
        }
        _ => return None,
    };
    Some(place)
}

/// Which of the three a projection is.
fn third(parts: &[&str]) -> Option<usize> {
    let projection = parts.iter().rev().nth(1)?;
    ["q_proj", "k_proj", "v_proj"]
        .iter()
        .position(|name| name == projection)
}

fn number(text: &str) -> Option<usize> {
    text.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of a tensor's name in the single file, its shape, and the folders and names that
    /// diffusers' own conversion gives it.
    type Row = (String, Vec<usize>, Vec<(String, String)>);

    const ROWS: &str = include_str!("../../tests/golden/single_file.json");
    const NAMES: [Names; 3] = [
        Names::Unet { resnets: 2 },
        Names::Vae { blocks: 3 },
        Names::Text { layers: 2 },
    ];

    fn names(folder: &str) -> Names {
        let named = |names: &Names| names.network().folder() == folder;
        NAMES.into_iter().find(named).unwrap()
    }

    #[test]
    fn every_name_of_diffusers_leads_to_the_tensor_that_it_was_converted_from() {
        let rows: Vec<Row> = serde_json::from_str(ROWS).unwrap();
        for (stored, _, places) in &rows {
            let thirds = places.len() == 3;
            for (i, (folder, name)) in places.iter().enumerate() {
                let expected = Stored {
                    name: stored.clone(),
                    third: thirds.then_some(i),
                };
                assert_eq!(names(folder).stored(name), expected, "{name}");
            }
        }
        let read = rows.iter().filter(|(_, _, places)| !places.is_empty());
        assert_eq!(read.count(), 919);
    }

    #[test]
    fn what_diffusers_leaves_behind_is_not_taken_and_all_else_is() {
        let rows: Vec<Row> = serde_json::from_str(ROWS).unwrap();
        for (stored, _, places) in &rows {
            let taken = NAMES.iter().any(|names| names.takes(stored));
            assert_eq!(taken, !places.is_empty(), "{stored}");
        }
    }

    #[test]
    fn a_name_without_counterpart_stays_and_is_never_found() {
        for name in ["down_blocks.x.resnets.0.conv1.weight", "conv_in", "", "a.b"] {
            let unet = Names::Unet { resnets: 2 };
            assert_eq!(
                unet.stored(name),
                Stored::whole(format!("model.diffusion_model.{name}"))
            );
        }
        let beyond = Names::Vae { blocks: 0 }.stored("decoder.up_blocks.0.resnets.0.conv1.weight");
        assert!(
            beyond
                .name
                .starts_with("first_stage_model.decoder.up_blocks"),
            "{beyond:?}"
        );
    }
}
