//! A network that a stage's parameters name: what the key and the plan ask of it. Knows no network.

use std::path::PathBuf;

use artifacts_schema::Digest;

use crate::error::StageError;

/// A network in files of the user's, or in this program.
pub trait Model {
    /// The parameters that say where it lies ([`crate::Stage::locations`]).
    fn locations(&self) -> &'static [&'static str];
    /// The digest of its weights and its configuration, for the key.
    fn content(&self) -> Result<Digest, StageError>;
    /// The files and folders that it consists of; `None` where that cannot be said.
    fn files(&self) -> Option<Vec<PathBuf>>;
}
