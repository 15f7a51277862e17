//! `export latents`: latent images for ComfyUI. Writes one folder.
//!
//! ComfyUI's `Save Latent` writes a safetensors file whose `latent_tensor` is what a VAE's encoder
//! gives, before any scaling (the model scales by itself), and an empty `latent_format_version_0`,
//! without which `Load Latent` takes the numbers for older ones times 0.18215.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use artifacts_schema::{ArtifactKind, LatentView, SchemaError, StoredLatents};
use clap::Args;
use formats::{Tensor, tensor_file};
use serde_json::json;

use super::error::Error;
use super::whole;
use crate::terminal::output::{print, print_json};

/// The tensors of a file of ComfyUI's.
const TENSOR: &str = "latent_tensor";
const VERSION: &str = "latent_format_version_0";

/// Options of `export latents`.
#[derive(Args)]
pub struct Latents {
    /// The folder of latent images (out/i3ds/i3ds.4.optimize/latents)
    latents: PathBuf,
    /// For ComfyUI's `Load Latent`: a NAME.latent for each view, to lie in its folder `input`
    #[arg(long, required = true)]
    comfyui: bool,
    /// The folder to write, which must not be there yet
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

impl Latents {
    /// Writes the folder and says what is in it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let refuse = |error: SchemaError| {
            let help = "give a folder of latent images, with latents.safetensors: an output of `Encode` or `Optimize`";
            Error::usage(error.to_string(), help)
        };
        let latents = StoredLatents::open(&self.latents, ArtifactKind::Latents).map_err(refuse)?;
        let heads = latents.heads();
        whole::folder(&self.output, |folder| {
            std::fs::create_dir(folder).map_err(|error| whole::refused(&self.output, &error))?;
            let mut views = latents.views();
            views.try_for_each(|view| {
                self.write(folder, &view.map_err(refuse)?, heads.scaling_factor)
            })
        })?;
        let count = heads.views.len();
        match json {
            true => print_json(&json!({"latents": count, "vae": heads.vae})),
            false => print(&format_args!(
                "{}: {count} latents of the VAE {}, which must decode them",
                self.output.display(),
                heads.vae
            )),
        }
        Ok(())
    }

    fn write(&self, folder: &Path, view: &LatentView, scaling_factor: f64) -> Result<(), Error> {
        let latent = unscaled(&view.tensor, scaling_factor);
        let version = Tensor {
            shape: vec![0],
            values: Vec::new(),
        };
        let tensors = BTreeMap::from([(TENSOR, latent.view()), (VERSION, version.view())]);
        let metadata = BTreeMap::from([("format", "pt".to_owned())]);
        let bytes = tensor_file::to_bytes(&tensors, &metadata)
            .map_err(|error| whole::refused(&self.output, &error))?;
        std::fs::write(folder.join(format!("{}.latent", view.name)), bytes)
            .map_err(|error| whole::refused(&self.output, &error))
    }
}

/// What the VAE's encoder gave, as a batch of one.
fn unscaled(tensor: &Tensor, scaling_factor: f64) -> Tensor {
    // In f64, so that the factor is not rounded to f32 before the division.
    let value = |value: &f32| (f64::from(*value) / scaling_factor) as f32;
    Tensor {
        // The shape [4, H, W] becomes [1, 4, H, W].
        shape: [&[1], &tensor.shape[..]].concat(),
        values: tensor.values.iter().map(value).collect(),
    }
}
