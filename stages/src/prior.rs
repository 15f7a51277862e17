//! The diffusion prior as a stage's parameters name it: its content, its files and its size. Knows
//! nothing of what a stage does with it.

use std::path::{Path, PathBuf};

use artifacts_schema::Digest;
use diffusion::{ModelSource, single_file};

use crate::error::StageError;
use crate::files;
use crate::model::Model;
use crate::size::Size;

impl Model for ModelSource {
    fn locations(&self) -> &'static [&'static str] {
        &["model"]
    }

    fn content(&self) -> Result<Digest, StageError> {
        Ok(Digest::new(self.digest()?))
    }

    fn files(&self) -> Option<Vec<PathBuf>> {
        match self {
            Self::Embedded => Some(Vec::new()),
            Self::Folder(folder) => files::tree(folder),
            Self::File(path) => Some(single_file::paths(path)),
        }
    }
}

/// Bytes of a latent for each pixel of its image.
pub fn latent_bytes(model: &ModelSource) -> u64 {
    match model {
        // 16 numbers for 4 x 4 pixels, and 4 in the upscalers that can be loaded.
        ModelSource::Embedded => 4,
        ModelSource::Folder(_) | ModelSource::File(_) => 1,
    }
}

/// Seconds of two cores to encode a pixel, roughly.
pub fn encoding_seconds(model: &ModelSource) -> f64 {
    match model {
        ModelSource::Embedded => 1.5e-6,
        ModelSource::Folder(_) | ModelSource::File(_) => 3e-5,
    }
}

/// Seconds of two cores to decode a pixel with what was encoded, roughly.
pub fn decoding_seconds(model: &ModelSource) -> f64 {
    // The decoder is the larger half, and runs twice where the residual alone is wanted.
    4.0 * encoding_seconds(model)
}

/// How many times as long a pixel takes in tiles of this side as in a picture of 256 x 192, of which
/// the seconds above are: attention within a tile grows with the square of its area.
pub fn in_tiles(images: Size, tile: u32) -> f64 {
    let tile = u64::from(tile).pow(2);
    let area = tile.min(images.largest) as f64 / (256.0 * 192.0);
    // Several tiles overlap by a quarter, and are gone through once before for their statistics.
    let passes = if images.largest > tile {
        2.0 * (4.0 / 3.0_f64).powi(2)
    } else {
        1.0
    };
    // Half of the time of the small picture is attention.
    passes * (0.5 + 0.5 * area)
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
