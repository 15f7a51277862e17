//! What a stage does with the diffusion prior that it names.

use std::path::PathBuf;

use artifacts_schema::Digest;
use diffusion::{ModelSource, Prior};

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
    let ModelSource::Folder(folder) = model else {
        return 512 << 20;
    };
    let parts = ["unet", "vae", "text_encoder"].map(|part| folder.join(part));
    let files = parts.iter().flat_map(std::fs::read_dir).flatten().flatten();
    let weights = files.filter(|file| {
        file.path()
            .extension()
            .is_some_and(|end| end == "safetensors")
    });
    (4 << 30)
        + 2 * weights
            .filter_map(|file| Some(file.metadata().ok()?.len()))
            .sum::<u64>()
}

/// The files that it consists of, beside this program.
pub fn files(model: &ModelSource) -> Option<Vec<PathBuf>> {
    match model {
        ModelSource::Embedded => Some(Vec::new()),
        ModelSource::Folder(folder) => files::tree(folder),
    }
}
