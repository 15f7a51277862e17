//! What a stage does with the diffusion prior that it names.

use std::path::{Path, PathBuf};

use artifacts_schema::Digest;
use diffusion::{ModelSource, Prior, single_file};

use crate::error::StageError;
use crate::files;
use crate::stage::{Io, Source};

/// The prior, on the stage's device.
pub fn load(model: &ModelSource, io: &Io) -> Result<Prior, StageError> {
    Ok(Prior::load(model, io.device)?)
}

/// The digest of its weights and configuration, for the key.
pub fn sources(model: &ModelSource) -> Result<Vec<Source>, StageError> {
    Ok(vec![Source {
        name: "model".into(),
        digest: Digest::new(model.digest()?),
    }])
}

/// Bytes of memory for its weights and for what lies between its layers, roughly.
pub fn memory(model: &ModelSource) -> u64 {
    let files = match model {
        ModelSource::Embedded => return 512 << 20,
        ModelSource::Folder(folder) => weights(folder),
        ModelSource::File(path) => vec![path.clone()],
    };
    let size = |file: &PathBuf| Some(file.metadata().ok()?.len());
    (4 << 30) + 2 * files.iter().filter_map(size).sum::<u64>()
}

/// The files of weights in a folder.
fn weights(folder: &Path) -> Vec<PathBuf> {
    let parts = ["unet", "vae", "text_encoder"].map(|part| folder.join(part));
    // An estimate passes over what cannot be read; loading the model says what is wrong.
    let files = parts.iter().flat_map(std::fs::read_dir).flatten().flatten();
    files
        .map(|file| file.path())
        // All variants count, though one is read: an estimate had better be too high.
        .filter(|path| path.extension().is_some_and(|end| end == "safetensors"))
        .collect()
}

/// The files that it consists of, beside this program.
pub fn files(model: &ModelSource) -> Option<Vec<PathBuf>> {
    match model {
        ModelSource::Embedded => Some(Vec::new()),
        ModelSource::Folder(folder) => files::tree(folder),
        ModelSource::File(path) => Some(single_file::paths(path)),
    }
}
