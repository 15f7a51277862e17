//! Where a model's files come from: the program itself, a folder in the diffusers layout, or a
//! single file that stands for one.
//!
//! Hands out named bytes. Knows which files a model is made of, not what stands in them.

mod embedded;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use compute::Device;
use formats::{FileBytes, FileError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::config;
use crate::error::ModelError;
use crate::network::Network;
use crate::single_file::{self, SingleFile};
use crate::weights::Weights;
use embedded::EMBEDDED;

/// Files that describe a model. Those that are absent are left out of the digest.
const DESCRIPTIONS: [&str; 10] = [
    "low_res_scheduler/scheduler_config.json",
    "model_index.json",
    "scheduler/scheduler_config.json",
    "text_encoder/config.json",
    "tokenizer/merges.txt",
    "tokenizer/special_tokens_map.json",
    "tokenizer/tokenizer_config.json",
    "tokenizer/vocab.json",
    "unet/config.json",
    "vae/config.json",
];

/// A tokenizer in one file, which counts where the vocabulary has no file of its own.
const TOKENIZER: &str = "tokenizer/tokenizer.json";
const VOCABULARY: &str = "tokenizer/vocab.json";

/// The endings under which diffusers saves weights whole, in the order of preference.
const WHOLE: [&str; 3] = [".safetensors", ".fp16.safetensors", ".bf16.safetensors"];

/// The endings under which diffusers saves the list of a sharded network's files.
const INDICES: [&str; 3] = [
    ".safetensors.index.json",
    ".safetensors.index.fp16.json",
    ".safetensors.index.bf16.json",
];

/// Which diffusion prior a stage uses.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum ModelSource {
    /// The small prior that the binary carries, `tiny-x4`.
    #[default]
    Embedded,
    /// A folder in the diffusers layout, such as `stabilityai/stable-diffusion-x4-upscaler`.
    Folder(PathBuf),
    /// The x4 upscaler in one file, `x4-upscaler-ema.safetensors`, with CLIP's `vocab.json` and
    /// `merges.txt`, or `tokenizer.json`, beside it.
    File(PathBuf),
}

/// The list of a sharded network's files.
#[derive(Deserialize)]
struct Index {
    /// For each tensor, the name of its file.
    weight_map: std::collections::BTreeMap<String, String>,
}

impl ModelSource {
    /// What lies at `path`: a single file, or else a folder.
    pub fn at(path: &Path) -> Self {
        if path.is_file() {
            Self::File(path.to_owned())
        } else {
            Self::Folder(path.to_owned())
        }
    }

    /// Which of the files `there` of the model `name` make it up, weights in `variant` where there
    /// are such. Fails where a network's weights are missing or pickled.
    pub fn choose(
        name: &str,
        there: &BTreeSet<String>,
        variant: Option<&str>,
    ) -> Result<Vec<String>, ModelError> {
        let has = |file: &String| there.contains(file);
        let mut chosen: Vec<String> = DESCRIPTIONS
            .map(str::to_owned)
            .into_iter()
            .filter(has)
            .collect();
        // A file that no run reads is not fetched either.
        let alone = Some(TOKENIZER.to_owned()).filter(|_| !there.contains(VOCABULARY));
        chosen.extend(alone.filter(has));
        for stem in Network::ALL.map(Network::stem) {
            let endings = WHOLE.map(str::to_owned);
            let wished = variant.map(|variant| format!(".{variant}.safetensors"));
            let mut whole = wished
                .into_iter()
                .chain(endings)
                .map(|ending| format!("{stem}{ending}"));
            let mut indices = INDICES.iter().map(|ending| format!("{stem}{ending}"));
            if let Some(file) = whole.find(has) {
                chosen.push(file);
            } else if let Some(index) = indices.find(has) {
                let shard =
                    |file: &&String| file.starts_with(stem) && file.ends_with(".safetensors");
                chosen.extend(there.iter().filter(shard).cloned().chain([index]));
            } else {
                let problem =
                    format!("has no {stem}.safetensors; pickled weights (.bin) are not read");
                return Err(ModelError::file(name, problem));
            }
        }
        Ok(chosen)
    }

    /// A digest of all files that decide what the model computes: the same for a folder and its
    /// embedded copy.
    ///
    /// Fails where a weight file is missing or a file cannot be read.
    pub fn digest(&self) -> Result<[u8; 32], ModelError> {
        // Of a single file the configurations that are written for it are hashed, too, so that a
        // change of what is assumed of it changes the keys.
        let mut hasher = blake3::Hasher::new_derive_key("srnerf-dag 1 model files");
        for (name, file) in self.descriptions()?.iter().chain(&self.weight_files()?) {
            absorb(&mut hasher, name, file);
        }
        Ok(*hasher.finalize().as_bytes())
    }

    /// All files that decide what the model computes.
    pub fn files(&self) -> Result<Vec<FileBytes>, ModelError> {
        let mut files = self.descriptions()?;
        if let Self::File(path) = self {
            // Configurations that are written from shapes are no files that could be listed.
            files.retain(|(name, _)| single_file::beside(path, name).is_some());
        }
        files.extend(self.weight_files()?);
        Ok(files.into_iter().map(|(_, file)| file).collect())
    }

    /// The files that say what the networks are, by their names.
    fn descriptions(&self) -> Result<Vec<(&'static str, FileBytes)>, ModelError> {
        if let Self::File(path) = self {
            SingleFile::open(path)?.check_vocabulary()?;
        }
        let mut files = Vec::new();
        for name in DESCRIPTIONS.iter().chain(self.tokenizer()?) {
            files.extend(self.find(name)?.map(|file| (*name, file)));
        }
        Ok(files)
    }

    /// The files of all weights, by what they hold.
    fn weight_files(&self) -> Result<Vec<(&'static str, FileBytes)>, ModelError> {
        if let Self::File(path) = self {
            let file = SingleFile::open(path)?.file().clone();
            return Ok(vec![("single_file", file)]);
        }
        let mut files = Vec::new();
        for stem in Network::ALL.map(Network::stem) {
            let of_network = self.network_files(stem)?.into_iter();
            files.extend(of_network.map(|file| (stem, file)));
        }
        Ok(files)
    }

    /// The name of a tokenizer's only file, where it has one alone.
    fn tokenizer(&self) -> Result<Option<&'static &'static str>, ModelError> {
        Ok(self.find(VOCABULARY)?.is_none().then_some(&TOKENIZER))
    }

    /// The file of this name; `None` where there is none.
    pub(crate) fn find(&self, name: &str) -> Result<Option<FileBytes>, ModelError> {
        match self {
            Self::Embedded => Ok(EMBEDDED
                .iter()
                .find(|(known, _)| *known == name)
                .map(|(_, bytes)| FileBytes::embedded(format!("tiny-x4/{name}"), bytes))),
            Self::Folder(folder) if folder.is_file() => {
                let problem = "is a file; name a model in one file by `File(..)`";
                Err(ModelError::file(folder.display().to_string(), problem))
            }
            Self::Folder(folder) => map(&folder.join(name)),
            Self::File(path) => SingleFile::open(path)?.find(name),
        }
    }

    /// The file of this name, which must be there.
    pub(crate) fn file(&self, name: &str) -> Result<FileBytes, ModelError> {
        match (self.find(name)?, self) {
            (Some(file), _) => Ok(file),
            (None, Self::File(path)) => Err(SingleFile::open(path)?.missing(name)),
            (None, _) => {
                let hint = "is missing; a model is a folder as diffusers saves it, with unet/, vae/, text_encoder/, tokenizer/ and \
                            scheduler/, or the x4 upscaler's single file";
                Err(ModelError::file(self.display(name), hint))
            }
        }
    }

    /// The weights of a network.
    pub(crate) fn weights(&self, network: Network, device: &Device) -> Result<Weights, ModelError> {
        match self {
            Self::File(path) => SingleFile::open(path)?.weights(network, device),
            _ => Weights::open(self.network_files(network.stem())?, device),
        }
    }

    /// The weight file whose name is `stem` and one of the endings that we read, or the shards of
    /// it.
    fn network_files(&self, stem: &str) -> Result<Vec<FileBytes>, ModelError> {
        // The plain file counts before its 16-bit variants, the order in which `choose` fetches
        // them.
        for ending in WHOLE {
            if let Some(file) = self.find(&format!("{stem}{ending}"))? {
                return Ok(vec![file]);
            }
        }
        for ending in INDICES {
            if let Some(index) = self.find(&format!("{stem}{ending}"))? {
                return self.shards(stem, &index);
            }
        }
        let pickled = format!("{}.bin", stem.replace("/model", "/pytorch_model"));
        if self.find(&pickled)?.is_some() {
            let hint = "is a pickle, which can run any code when it is read; save the model with \
                        `save_pretrained(folder, safe_serialization=True)`, or download its .safetensors files";
            return Err(ModelError::file(self.display(&pickled), hint));
        }
        let hint =
            "is missing (nor is there a .fp16.safetensors or a .safetensors.index.json beside it)";
        Err(ModelError::file(
            self.display(&format!("{stem}.safetensors")),
            hint,
        ))
    }

    /// The files that `index` lists, sorted; they lie beside it.
    fn shards(&self, stem: &str, index: &FileBytes) -> Result<Vec<FileBytes>, ModelError> {
        let Index { weight_map } = config::parse(index, &json!({}), &[])?;
        let names: BTreeSet<&String> = weight_map.values().collect();
        let folder = stem.rsplit_once('/').map_or("", |(folder, _)| folder);
        // An index is foreign: a name with a path in it could lead out of the model's folder.
        let plain = |name: &str| name.ends_with(".safetensors") && !name.contains(['/', '\\']);
        if let Some(name) = names.iter().find(|name| !plain(name)) {
            let problem =
                format!("names {name:?}; a shard is a .safetensors file beside its index");
            return Err(ModelError::field(index.name(), "weight_map", problem));
        }
        names
            .iter()
            .map(|name| self.file(&format!("{folder}/{name}")))
            .collect()
    }

    fn display(&self, name: &str) -> String {
        match self {
            Self::Embedded => format!("tiny-x4/{name}"),
            Self::Folder(path) | Self::File(path) => path.join(name).display().to_string(),
        }
    }
}

fn absorb(hasher: &mut blake3::Hasher, name: &str, bytes: &[u8]) {
    // With lengths, no two lists of files give the same stream: a byte cannot pass from one part to
    // the next.
    for part in [name.as_bytes(), bytes] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update_rayon(part);
    }
}

/// The file at `path`; `None` where there is none.
pub(crate) fn map(path: &Path) -> Result<Option<FileBytes>, ModelError> {
    match FileBytes::map(path) {
        Ok(file) => Ok(Some(file)),
        // Only absence is `None`. A file that is there and cannot be read must not pass for a model
        // without it.
        Err(FileError::Missing { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests;
