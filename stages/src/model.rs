//! Which diffusion prior a stage uses.

use std::path::PathBuf;

use artifacts_schema::Digest;
use compute::Precision;
use diffusion::{ModelSource, Prior};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::StageError;
use crate::files;
use crate::stage::{Io, Source};

/// Which diffusion prior a stage uses.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Model {
    /// The small prior that the binary carries, `tiny-x4`.
    #[default]
    Embedded,
    /// A folder in the diffusers layout, such as `stabilityai/stable-diffusion-x4-upscaler`.
    Folder(PathBuf),
}

/// The number format of the factors in the UNet's products; sums are always in `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Factors {
    /// Single precision.
    #[default]
    F32,
    /// Brain floats, the upper half of an `f32`: the error is some 2e-3 of a product's norm.
    Bf16,
}

impl Model {
    /// The prior, on the stage's device.
    pub fn load(&self, io: &Io) -> Result<Prior, StageError> {
        Ok(Prior::load(&self.source(), io.device)?)
    }

    /// The prior with a UNet that multiplies in `factors`.
    pub fn load_in(&self, io: &Io, factors: Factors) -> Result<Prior, StageError> {
        let precision = match factors {
            Factors::F32 => Precision::F32,
            Factors::Bf16 => Precision::Bf16,
        };
        Ok(Prior::load_in(&self.source(), io.device, precision)?)
    }

    /// The digest of its weights and configuration, for the key.
    pub fn sources(&self) -> Result<Vec<Source>, StageError> {
        Ok(vec![Source {
            name: "model".into(),
            digest: Digest::new(self.source().digest()?),
        }])
    }

    /// Bytes of memory for its weights and for what lies between its layers, roughly.
    pub fn memory(&self) -> u64 {
        let Self::Folder(folder) = self else {
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
    pub fn files(&self) -> Option<Vec<PathBuf>> {
        match self {
            Self::Embedded => Some(Vec::new()),
            Self::Folder(folder) => files::tree(folder),
        }
    }

    fn source(&self) -> ModelSource {
        match self {
            Self::Embedded => ModelSource::Embedded,
            Self::Folder(folder) => ModelSource::Folder(folder.clone()),
        }
    }
}
