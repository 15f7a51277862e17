//! Where a model's files come from: the program itself, or a folder in the diffusers layout.
//!
//! Hands out named bytes. Knows which files a model is made of, not what stands in them.

use std::fs::File;
use std::io::ErrorKind;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use memmap2::Mmap;

use crate::error::ModelError;

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

/// Weight files without their endings.
const WEIGHTS: [&str; 3] = ["text_encoder/model", "unet/diffusion_pytorch_model", "vae/diffusion_pytorch_model"];

/// The endings under which diffusers saves weights, in the order of preference.
const WEIGHT_ENDINGS: [&str; 2] = [".safetensors", ".fp16.safetensors"];

macro_rules! embedded {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_bytes!(concat!("../models/tiny-x4/", $name)).as_slice())),*]
    };
}

const EMBEDDED: &[(&str, &[u8])] = embedded![
    "low_res_scheduler/scheduler_config.json",
    "model_index.json",
    "scheduler/scheduler_config.json",
    "text_encoder/config.json",
    "text_encoder/model.safetensors",
    "tokenizer/merges.txt",
    "tokenizer/special_tokens_map.json",
    "tokenizer/tokenizer_config.json",
    "tokenizer/vocab.json",
    "unet/config.json",
    "unet/diffusion_pytorch_model.safetensors",
    "vae/config.json",
    "vae/diffusion_pytorch_model.safetensors",
];

/// Where a model is read from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ModelSource {
    /// `tiny-x4`, the small prior that the program carries.
    Embedded,
    /// A folder in the layout of `StableDiffusionUpscalePipeline.save_pretrained`.
    Folder(PathBuf),
}

/// One file of a model.
pub(crate) struct ModelFile {
    /// How messages name it.
    pub name: String,
    bytes: Bytes,
}

enum Bytes {
    Static(&'static [u8]),
    Mapped(Mmap),
}

impl Deref for ModelFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.bytes {
            Bytes::Static(bytes) => bytes,
            Bytes::Mapped(map) => map,
        }
    }
}

impl ModelSource {
    /// A digest of all files that decide what the model computes: the same for a folder and its embedded copy.
    ///
    /// Fails where a weight file is missing or a file cannot be read.
    pub fn digest(&self) -> Result<[u8; 32], ModelError> {
        let mut hasher = blake3::Hasher::new_derive_key("srnerf-dag 1 model files");
        for name in DESCRIPTIONS {
            if let Some(file) = self.find(name)? {
                absorb(&mut hasher, name, &file);
            }
        }
        for stem in WEIGHTS {
            absorb(&mut hasher, stem, &self.weights(stem)?);
        }
        Ok(*hasher.finalize().as_bytes())
    }

    /// The file of this name; `None` where there is none.
    pub(crate) fn find(&self, name: &str) -> Result<Option<ModelFile>, ModelError> {
        match self {
            Self::Embedded => Ok(EMBEDDED
                .iter()
                .find(|(known, _)| *known == name)
                .map(|(_, bytes)| ModelFile { name: format!("tiny-x4/{name}"), bytes: Bytes::Static(bytes) })),
            Self::Folder(folder) => map(&folder.join(name)),
        }
    }

    /// The file of this name, which must be there.
    pub(crate) fn file(&self, name: &str) -> Result<ModelFile, ModelError> {
        let hint = "is missing; a model is a folder as diffusers saves it, with unet/, vae/, text_encoder/, tokenizer/ and scheduler/";
        self.find(name)?.ok_or_else(|| ModelError::file(self.display(name), hint))
    }

    /// The weight file whose name is `stem` and one of the endings that we read.
    pub(crate) fn weights(&self, stem: &str) -> Result<ModelFile, ModelError> {
        for ending in WEIGHT_ENDINGS {
            if let Some(file) = self.find(&format!("{stem}{ending}"))? {
                return Ok(file);
            }
        }
        let pickled = format!("{}.bin", stem.replace("/model", "/pytorch_model"));
        if self.find(&pickled)?.is_some() {
            let hint = "is a pickle, which can run any code when it is read; save the model with \
                        `save_pretrained(folder, safe_serialization=True)`, or download its .safetensors files";
            return Err(ModelError::file(self.display(&pickled), hint));
        }
        let wanted = format!("{stem}.safetensors");
        Err(ModelError::file(self.display(&wanted), "is missing (nor is there a .fp16.safetensors beside it)"))
    }

    fn display(&self, name: &str) -> String {
        match self {
            Self::Embedded => format!("tiny-x4/{name}"),
            Self::Folder(folder) => folder.join(name).display().to_string(),
        }
    }
}

fn absorb(hasher: &mut blake3::Hasher, name: &str, bytes: &[u8]) {
    for part in [name.as_bytes(), bytes] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update_rayon(part);
    }
}

#[allow(unsafe_code)]
fn map(path: &Path) -> Result<Option<ModelFile>, ModelError> {
    let name = path.display().to_string();
    let unreadable = |e: std::io::Error| ModelError::file(&name, format!("cannot be read: {e}"));
    let file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(unreadable(e)),
    };
    if !file.metadata().map_err(unreadable)?.is_file() {
        return Err(ModelError::file(&name, "is not a file"));
    }
    // SAFETY: the map is read-only and private to this process; model files are not rewritten while they are loaded.
    let map = unsafe { Mmap::map(&file) }.map_err(unreadable)?;
    Ok(Some(ModelFile { name, bytes: Bytes::Mapped(map) }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn copy_embedded(folder: &Path) {
        for (name, bytes) in EMBEDDED {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
    }

    #[test]
    fn a_folder_and_its_embedded_copy_have_one_digest_and_every_file_counts() {
        let folder = tempfile::tempdir().unwrap();
        copy_embedded(folder.path());
        let source = ModelSource::Folder(folder.path().to_owned());
        let digest = ModelSource::Embedded.digest().unwrap();
        assert_eq!(source.digest().unwrap(), digest);
        let plain = folder.path().join("vae/diffusion_pytorch_model.safetensors");
        std::fs::rename(&plain, folder.path().join("vae/diffusion_pytorch_model.fp16.safetensors")).unwrap();
        assert_eq!(source.digest().unwrap(), digest);
        std::fs::write(folder.path().join("model_index.json"), "{}").unwrap();
        assert_ne!(source.digest().unwrap(), digest);
    }

    #[test]
    fn what_is_missing_or_pickled_is_named_with_the_way_out() {
        let folder = tempfile::tempdir().unwrap();
        copy_embedded(folder.path());
        let source = ModelSource::Folder(folder.path().to_owned());
        std::fs::remove_file(folder.path().join("text_encoder/model.safetensors")).unwrap();
        let missing = source.digest().unwrap_err().to_string();
        assert!(missing.contains("text_encoder/model.safetensors: is missing"), "{missing}");
        std::fs::write(folder.path().join("text_encoder/pytorch_model.bin"), "x").unwrap();
        let pickled = source.digest().unwrap_err().to_string();
        assert!(
            pickled.contains("pytorch_model.bin: is a pickle") && pickled.contains("safe_serialization"),
            "{pickled}"
        );
    }
}
