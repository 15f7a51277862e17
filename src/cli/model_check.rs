//! `model check`: reads every part of a model as a run would, and says what is there. Writes
//! nothing.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use compute::Device;
use diffusion::ModelSource;
use diffusion::inventory::{PartReport, inspect};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::error::Error;
use super::upsample;
use crate::terminal::output::{print, print_json, size, table};

/// Options of `model check`.
#[derive(Args)]
pub struct Check {
    /// The model's folder, in the layout of diffusers, or the x4 upscaler's single .safetensors; for
    /// an upsampler its file: .safetensors, or either of ncnn's .param and .bin; or `embedded`, for
    /// what the program carries
    model: PathBuf,
    /// What it is, if it is no diffusion model
    #[arg(long)]
    part: Option<PartName>,
}

#[derive(Clone, Copy, ValueEnum)]
enum PartName {
    Upsample,
}

/// Whether this names what the program carries: by the word, where nothing is called so.
pub fn is_embedded(model: &Path) -> bool {
    model == Path::new("embedded") && !model.exists()
}

/// The diffusion model of this name.
pub fn diffusion_source(model: &Path) -> ModelSource {
    if is_embedded(model) {
        ModelSource::Embedded
    } else {
        ModelSource::at(model)
    }
}

impl Check {
    /// Reads all parts, and prints what they are.
    pub fn run(self, json: bool) -> Result<(), Error> {
        if let Some(PartName::Upsample) = self.part {
            return upsample::check(&self.model, json);
        }
        let source = diffusion_source(&self.model);
        // On the CPU: reading needs no GPU, and a model must not fail its check for want of its
        // memory.
        let parts = inspect(&source, &Device::cpu())?;
        let mut digests = Vec::new();
        for file in source.files()? {
            digests.push((
                file.name().to_owned(),
                file.len() as u64,
                // The digest that the hub lists for large files, so that both can be compared.
                hex(&Sha256::digest(&file[..])),
            ));
        }
        if json {
            let files: Vec<Value> = digests
                .iter()
                .map(
                    |(name, bytes, sha256)| json!({"file": name, "bytes": bytes, "sha256": sha256}),
                )
                .collect();
            print_json(
                &json!({"model": self.model, "parts": parts.iter().map(part_json).collect::<Vec<_>>(), "files": files}),
            );
            return Ok(());
        }
        let head = [
            "part",
            "tensors",
            "parameters",
            "stored as",
            "memory",
            "configuration",
        ]
        .map(str::to_owned)
        .to_vec();
        let rows: Vec<Vec<String>> = std::iter::once(head)
            .chain(parts.iter().map(part_row))
            .collect();
        print(&table(&rows, false));
        let rows: Vec<Vec<String>> = digests
            .into_iter()
            .map(|(name, bytes, digest)| vec![digest, size(bytes), name])
            .collect();
        print(&format_args!("\nsha256\n{}", table(&rows, false)));
        let memory = parts.iter().map(|part| part.memory).sum::<usize>() as u64;
        print(&format_args!(
            "\nThe weights of all parts take {} of memory.",
            size(memory)
        ));
        Ok(())
    }
}

fn part_json(part: &PartReport) -> Value {
    json!({
        "part": part.name, "tensors": part.tensors, "parameters": part.parameters, "types": part.types,
        "memory_bytes": part.memory, "configuration": part.summary,
    })
}

fn part_row(part: &PartReport) -> Vec<String> {
    let types: Vec<&str> = part.types.keys().map(String::as_str).collect();
    let parameters = format!("{:.1} M", part.parameters as f64 / 1e6);
    let memory = size(part.memory as u64);
    vec![
        part.name.into(),
        part.tensors.to_string(),
        parameters,
        types.join(", "),
        memory,
        part.summary.clone(),
    ]
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
