//! What people see: `out/<pipeline>/<stage>/<output>/..`, links into the store that every run
//! refreshes.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::Store;
use super::error::{At, StoreError};
use super::files::{parent, read_json};
use super::record::Record;

/// The file that remembers which folders are ours, so that nothing else is ever removed.
const LIST: &str = ".srnerf-stages.json";

/// The folder in which people find the results of one pipeline.
#[derive(Clone)]
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

    /// Where the outputs of a stage are shown.
    pub fn stage(&self, stage: &str) -> PathBuf {
        self.folder.join(stage)
    }

    /// Where an output of a stage is shown.
    pub fn output(&self, stage: &str, output: &str) -> PathBuf {
        self.folder.join(stage).join(output)
    }

    /// Shows a result as that of each of these stages.
    pub fn show_all<'s>(
        &self,
        store: &Store,
        stages: impl IntoIterator<Item = &'s str>,
        record: &Record,
    ) -> Result<(), StoreError> {
        let mut stages = stages.into_iter();
        stages.try_for_each(|stage| self.show(store, stage, record))
    }

    /// Shows a stage's result.
    pub fn show(&self, store: &Store, stage: &str, record: &Record) -> Result<(), StoreError> {
        record
            .outputs
            .iter()
            .try_for_each(|(name, output)| output.show(store, &self.output(stage, name)))
    }

    /// The file that remembers which folders are ours.
    pub fn list(&self) -> PathBuf {
        self.folder.join(LIST)
    }

    /// Removes the folders of stages that the pipeline had once and has no more.
    pub fn retain(&self, store: &Store, stages: BTreeSet<String>) -> Result<(), StoreError> {
        let list = self.list();
        let text = serde_json::json!(stages).to_string();
        // Untouched where nothing is new: the list is part of what a run with nothing to do looks
        // at.
        if fs::read(&list).is_ok_and(|before| before == text.as_bytes()) {
            return Ok(());
        }
        // A list that cannot be understood names nothing: then too much stays, and nothing of the
        // user's is removed.
        let before: BTreeSet<String> = read_json(&list)?.unwrap_or_default();
        for gone in before.difference(&stages).filter(|name| is_ours(name)) {
            store.files.clear(&self.folder.join(gone))?;
        }
        // The list is written last: whoever is killed before finds the old names in it, and removes
        // them again.
        fs::create_dir_all(parent(&list)).at("create", parent(&list))?;
        fs::write(&list, text).at("write", &list)?;
        Ok(())
    }
}

/// Whether a name in the list can be that of a stage's folder, which may lie in that of an arm.
fn is_ours(name: &str) -> bool {
    // The list is a file that anyone can edit. A name with `..` in it must not lead out of the
    // folder.
    let is_plain = |part: &str| !part.is_empty() && !part.starts_with('.');
    !name.contains(['\\', ':']) && name.split('/').all(is_plain)
}

#[cfg(test)]
mod tests;
