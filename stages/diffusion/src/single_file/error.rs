//! Why a single file could not be used: what it is or lacks, and the way out.

use crate::network::Network;

/// Why a file is not the x4 upscaler in one file, or not all of it.
#[derive(Debug, thiserror::Error)]
pub enum SingleFileError {
    /// A `.ckpt`, which is a pickle and never opened.
    #[error(
        "{file}: is a pickle, which can run any code when it is read; x4-upscaler-ema.safetensors lies beside it where it came from. \
         Where you trust it, convert it:\n{CONVERT}"
    )]
    Pickle {
        /// The pickle, as it was named.
        file: String,
    },
    /// Another model, or a model in another layout.
    #[error(
        "{file}: is {model}: {why}; expected the Stable Diffusion x4 upscaler, x4-upscaler-ema.safetensors"
    )]
    OtherModel {
        /// The file, as it was named.
        file: String,
        /// What it seems to be.
        model: &'static str,
        /// The tensor or the shape by which it is told.
        why: String,
    },
    /// A tensor that is not there.
    #[error(
        "{file}: tensor `{stored}` is missing, which is {place} of diffusers; get the file anew, whole"
    )]
    Missing {
        /// The file that lacks it.
        file: String,
        /// The tensor's name in the file.
        stored: String,
        /// Its name and folder in diffusers: "`conv_in.weight` in unet/".
        place: String,
    },
    /// A tensor of a shape that does not go with those of the others.
    #[error("{file}: tensor `{stored}` {problem}")]
    Shape {
        /// The file that holds it.
        file: String,
        /// The tensor's name in the file.
        stored: String,
        /// What is wrong: "has the shape [4, 1]; `quant_conv.weight` in vae/ of diffusers asks for [4, 4]".
        problem: String,
    },
    /// No vocabulary beside the file.
    #[error(
        "{missing}: is missing, and {file} carries no vocabulary; put `vocab.json` and `merges.txt`, or `tokenizer.json`, of CLIP beside \
         it: any Stable Diffusion has them in tokenizer/"
    )]
    NoVocabulary {
        /// The file that was looked for.
        missing: String,
        /// The model's file, beside which it should be.
        file: String,
    },
}

/// How a pickle becomes a file that is read.
const CONVERT: &str = "    python3 -c 'import sys, torch, safetensors.torch as s; d = torch.load(sys.argv[1], map_location=\"cpu\", weights_only=True)\n\
    d = d.get(\"state_dict\", d); s.save_file({k: v.clone() for k, v in d.items()}, sys.argv[2])' IN.ckpt OUT.safetensors";

impl SingleFileError {
    /// A tensor of `network` that is not there, by its name in the file and in diffusers.
    pub(crate) fn missing(file: &str, network: Network, stored: &str, name: &str) -> Self {
        Self::Missing {
            file: file.to_owned(),
            stored: stored.to_owned(),
            place: place(network, name),
        }
    }

    /// A tensor of `network` of the shape `has`, by its name in the file and in diffusers.
    pub(crate) fn shape(
        file: &str,
        network: Network,
        stored: &str,
        name: &str,
        has: &[usize],
        expected: &str,
    ) -> Self {
        let place = place(network, name);
        Self::Shape {
            file: file.to_owned(),
            stored: stored.to_owned(),
            problem: format!("has the shape {has:?}; {place} of diffusers asks for {expected}"),
        }
    }
}

fn place(network: Network, name: &str) -> String {
    format!("`{name}` in {}/", network.folder())
}
