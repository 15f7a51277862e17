//! `export kohya`: a LoRA under the names that kohya's scripts use. Writes one file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use artifacts_schema::{Artifact, Lora};
use clap::Args;
use diffusion::kohya;
use formats::tensor_file;
use serde_json::json;

use super::error::Error;
use super::whole;
use crate::terminal::output::{print, print_json};

/// Options of `export kohya`.
#[derive(Args)]
pub struct Kohya {
    /// The folder of a LoRA (out/i3ds/main/refine/lora)
    lora: PathBuf,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Kohya {
    /// Writes the file and says what is in it, and what is not.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let lora = Lora::read(&self.lora).map_err(|error| {
            Error::usage(
                error.to_string(),
                "give the folder of a LoRA that `Optimize` wrote",
            )
        })?;
        let tensors = kohya::tensors(&lora.tensors, lora.alpha);
        let views = tensors
            .iter()
            .map(|(name, tensor)| (name.as_str(), tensor.view()));
        let bytes = tensor_file::to_bytes(&views.collect(), &metadata(&lora))
            .map_err(|error| Error::usage(error.to_string(), "the LoRA is damaged"))?;
        whole::file(&self.output, |out| out.write_all(&bytes))?;
        // Each layer has three tensors in this layout: `lora_down`, `lora_up` and `alpha`.
        let layers = tensors.len() / 3;
        let left_out = lora.camera.len();
        match json {
            true => print_json(&json!({"layers": layers, "left_out": left_out})),
            false => print(&format_args!(
                "{}: {layers} layers of rank {}; without the camera embedding, for which this layout has no place",
                self.output.display(),
                lora.rank
            )),
        }
        Ok(())
    }
}

/// What kohya's scripts write of themselves, and programs read.
fn metadata(lora: &Lora) -> BTreeMap<&'static str, String> {
    BTreeMap::from([
        ("ss_network_module", "networks.lora".to_owned()),
        ("ss_network_dim", lora.rank.to_string()),
        ("ss_network_alpha", lora.alpha.to_string()),
    ])
}
