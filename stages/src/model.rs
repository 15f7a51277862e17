//! Which diffusion prior a stage uses.

use std::path::PathBuf;

use artifacts_schema::Digest;
use diffusion::{ModelSource, Prior};
use serde::{Deserialize, Serialize};

use crate::error::StageError;
use crate::files;
use crate::stage::{Io, Source};

/// Which diffusion prior a stage uses.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Model {
    /// The small prior that the binary carries, `tiny-x4`.
    #[default]
    Embedded,
    /// A folder in the diffusers layout, such as `stabilityai/stable-diffusion-x4-upscaler`.
    Folder(PathBuf),
}

impl Model {
    /// The prior, on the stage's device.
    pub fn load(&self, io: &Io) -> Result<Prior, StageError> {
        Ok(Prior::load(&self.source(), io.device)?)
    }

    /// The digest of its weights and configuration, for the key.
    pub fn sources(&self) -> Result<Vec<Source>, StageError> {
        Ok(vec![Source { name: "model".into(), digest: Digest::new(self.source().digest()?) }])
    }

    /// The files that it consists of.
    pub fn files(&self) -> Option<Vec<PathBuf>> {
        match self {
            Self::Embedded => None,
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
