//! Pins: named sets of results that stay until they are unpinned.

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};

use super::Store;
use super::error::{At, StoreError};
use super::files::{json, read_json};
use super::runs::RunRecord;

/// A named set of results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pin {
    /// Its name, that of its file.
    pub name: String,
    /// The pipeline that the results are of.
    pub pipeline: String,
    /// When the run that they are of began.
    pub started: String,
    /// Their keys, by stage.
    pub keys: BTreeMap<String, Digest>,
}

impl Pin {
    /// A pin of all results of a run, or of some of its stages.
    pub fn new(name: &str, run: &RunRecord, stages: impl Fn(&str) -> bool) -> Self {
        let wanted = run.stages.iter().filter(|(stage, _)| stages(stage));
        let keys = wanted
            .filter_map(|(stage, run)| Some((stage.clone(), run.key?)))
            .collect();
        Self {
            name: name.to_owned(),
            pipeline: run.pipeline.clone(),
            started: run.started.clone(),
            keys,
        }
    }

    /// All pins, by name.
    pub fn all(store: &Store) -> Result<Vec<Self>, StoreError> {
        let mut pins = Vec::new();
        for entry in store.files.entries("pins")? {
            // One that cannot be understood may stand for anything: nothing is removed then.
            let pin = read_json::<Self>(&entry.path)?;
            let garbled = || {
                io::Error::new(
                    io::ErrorKind::InvalidData,
                    "the pin is garbled; remove the file, or pin anew",
                )
            };
            pins.push(pin.ok_or_else(garbled).at("understand", &entry.path)?);
        }
        Ok(pins)
    }

    /// Keeps it; one of the same name is replaced.
    pub fn keep(&self, store: &Store) -> Result<(), StoreError> {
        let path = path(store, &self.name);
        store.files.put(&path, &json(&path, self)?)
    }

    /// Removes a pin. Whether there was one.
    pub fn remove(store: &Store, name: &str) -> Result<bool, StoreError> {
        let path = path(store, name);
        // Removing what is absent is no error, so that has to be asked before.
        let there = path.exists();
        store
            .files
            .disk
            .remove_file(&path)
            .at("remove", &path)
            .map(|()| there)
    }
}

fn path(store: &Store, name: &str) -> PathBuf {
    store.files.root.join("pins").join(format!("{name}.json"))
}
