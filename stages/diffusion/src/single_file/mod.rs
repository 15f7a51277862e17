//! The Stable Diffusion x4 upscaler in one file, `x4-upscaler-ema.safetensors`, as Stability and
//! ComfyUI have it: shown as the folder that diffusers would make of it.
//!
//! Tensors stay mapped in the file under its own names (`names`); configurations are written from
//! their shapes (`sizes`) and from what is known of this one model (`known`). The vocabulary lies
//! beside the file. Knows no other model of latent diffusion, and opens no pickle.

pub(crate) mod error;
mod family;
mod known;
pub(crate) mod names;
mod sizes;

use std::path::{Path, PathBuf};

use compute::Device;
use formats::{FileBytes, TensorFile};

use crate::error::ModelError;
use crate::network::Network;
use crate::source::map;
use crate::weights::Weights;

pub use error::SingleFileError;

/// The files of a vocabulary that count where they lie beside the model's.
const VOCABULARY: [&str; 3] = ["merges.txt", "tokenizer.json", "vocab.json"];

/// Endings of files that are pickles, whatever is in them.
const PICKLES: [&str; 5] = ["bin", "ckpt", "pkl", "pt", "pth"];

/// How a zip archive begins, which is what PyTorch wraps its pickles in.
const ZIP: &[u8] = b"PK\x03\x04";

/// An open single file.
pub(crate) struct SingleFile {
    path: PathBuf,
    tensors: TensorFile,
}

impl SingleFile {
    /// Reads the header. Fails for what is not the x4 upscaler by saying what it is.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        let name = path.display().to_string();
        if path.is_dir() {
            let problem = "is a folder; name a model's folder by `Folder(..)`";
            return Err(ModelError::file(name, problem));
        }
        let bytes = FileBytes::map(path)?;
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        // By content and by ending: pickles from before PyTorch 1.6 are no zip archives.
        if bytes.starts_with(ZIP) || PICKLES.contains(&&*ending.to_ascii_lowercase()) {
            return Err(SingleFileError::Pickle { file: name }.into());
        }
        let tensors = TensorFile::new(bytes)?;
        family::check(&tensors)?;
        Ok(Self {
            path: path.to_owned(),
            tensors,
        })
    }

    /// What stands in the file of this name in diffusers' folder; `None` where there is none.
    pub fn find(&self, name: &str) -> Result<Option<FileBytes>, ModelError> {
        let written = match name {
            "unet/config.json" => sizes::config(&self.tensors, Network::Unet)?,
            "vae/config.json" => sizes::config(&self.tensors, Network::Vae)?,
            "text_encoder/config.json" => sizes::config(&self.tensors, Network::TextEncoder)?,
            "scheduler/scheduler_config.json" => known::scheduler(),
            "low_res_scheduler/scheduler_config.json" => known::low_res_scheduler(),
            "model_index.json" => known::pipeline(),
            "tokenizer/special_tokens_map.json" => known::special_tokens(),
            _ => return beside(&self.path, name).map_or(Ok(None), |path| map(&path)),
        };
        // Messages name the real file, since nothing on disk is called as diffusers calls it.
        let shown = format!("{}, as {name}", self.tensors.name());
        let text = written.to_string().into_bytes();
        Ok(Some(FileBytes::in_memory(shown, text)))
    }

    /// Why there is no file of this name.
    pub fn missing(&self, name: &str) -> ModelError {
        let place = beside(&self.path, name).unwrap_or_else(|| self.path.join(name));
        let missing = place.display().to_string();
        let file = self.tensors.name().to_owned();
        SingleFileError::NoVocabulary { missing, file }.into()
    }

    /// Fails where the vocabulary is missing, or a part of it.
    pub fn check_vocabulary(&self) -> Result<(), ModelError> {
        let there = |table| self.path.with_file_name(table).is_file();
        // The same choice as the tokenizer's: `tokenizer.json` counts only where there is no
        // `vocab.json`.
        match VOCABULARY.map(there) {
            [true, _, true] | [_, true, false] => Ok(()),
            [false, _, true] => Err(self.missing("tokenizer/merges.txt")),
            [_, false, false] => Err(self.missing("tokenizer/vocab.json")),
        }
    }

    /// The weights of a network.
    pub fn weights(self, network: Network, device: &Device) -> Result<Weights, ModelError> {
        let names = sizes::names(&self.tensors, network)?;
        Ok(Weights::single(self.tensors, names, device))
    }

    /// The mapped file that the tensors lie in.
    pub fn file(&self) -> &FileBytes {
        self.tensors.file()
    }
}

/// Where the file of this name in diffusers' folder lies beside the single file, if it is one of
/// the vocabulary's.
pub(crate) fn beside(path: &Path, name: &str) -> Option<PathBuf> {
    let table = name.strip_prefix("tokenizer/")?;
    VOCABULARY
        .contains(&table)
        .then(|| path.with_file_name(table))
}

/// The files that the model in `path` consists of: itself, and the vocabulary beside it.
pub fn paths(path: &Path) -> Vec<PathBuf> {
    let tables = VOCABULARY.map(|table| path.with_file_name(table));
    let there = tables.into_iter().filter(|table| table.is_file());
    std::iter::once(path.to_owned()).chain(there).collect()
}

#[cfg(test)]
mod tests;
