//! What people see: `out/<pipeline>/<stage>/<output>/..`, links into the store that every run refreshes.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::error::{At, StoreError};
use super::result::Record;
use super::{Store, parent, read_json};

/// The file that remembers which folders are ours, so that nothing else is ever removed.
const LIST: &str = ".srnerf-stages.json";

/// The folder in which people find the results of one pipeline.
pub struct View {
    folder: PathBuf,
}

impl View {
    /// The folder of a pipeline under `out`.
    pub fn new(out: &Path, pipeline: &str) -> Self {
        Self {
            folder: out.join(pipeline),
        }
    }

    /// Where an output of a stage is shown.
    pub fn output(&self, stage: &str, output: &str) -> PathBuf {
        self.folder.join(stage).join(output)
    }

    /// Shows a stage's result.
    pub fn show(&self, store: &Store, stage: &str, record: &Record) -> Result<(), StoreError> {
        record
            .outputs
            .iter()
            .try_for_each(|(name, output)| store.show(output, &self.output(stage, name)))
    }

    /// The file that remembers which folders are ours.
    pub fn list(&self) -> PathBuf {
        self.folder.join(LIST)
    }

    /// Removes the folders of stages that the pipeline had once and has no more.
    pub fn retain(&self, store: &Store, stages: BTreeSet<String>) -> Result<(), StoreError> {
        let (list, text) = (self.list(), serde_json::json!(stages).to_string());
        if fs::read(&list).is_ok_and(|before| before == text.as_bytes()) {
            return Ok(());
        }
        let before: BTreeSet<String> = read_json(&list)?.unwrap_or_default();
        for gone in before.difference(&stages).filter(|name| is_ours(name)) {
            store.clear(&self.folder.join(gone))?;
        }
        fs::create_dir_all(parent(&list)).at("create", parent(&list))?;
        fs::write(&list, text).at("write", &list)?;
        Ok(())
    }
}

/// Whether a name in the list can be that of a stage's folder.
fn is_ours(name: &str) -> bool {
    !name.contains(['/', '\\']) && !name.starts_with('.')
}
