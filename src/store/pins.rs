//! Pins: named sets of results that stay until they are unpinned.

use std::collections::BTreeMap;
use std::io;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};

use super::Store;
use super::error::{At, StoreError};
use super::files::{json, read_json};
use super::runs::Run;

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
    pub fn new(name: &str, run: &Run, stages: impl Fn(&str) -> bool) -> Self {
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
}

impl Store {
    /// All pins, by name.
    pub fn pins(&self) -> Result<Vec<Pin>, StoreError> {
        let mut pins = Vec::new();
        for entry in self.files.entries("pins")? {
            // One that cannot be understood may stand for anything: nothing is removed then.
            let pin = read_json::<Pin>(&entry.path)?;
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

    /// Keeps a pin; one of the same name is replaced.
    pub fn put_pin(&self, pin: &Pin) -> Result<(), StoreError> {
        let path = self.pin_path(&pin.name);
        self.files.put(&path, &json(&path, pin)?)
    }

    /// Removes a pin. Whether there was one.
    pub fn remove_pin(&self, name: &str) -> Result<bool, StoreError> {
        let path = self.pin_path(name);
        // Removing what is absent is no error, so that has to be asked before.
        let there = path.exists();
        self.files
            .disk
            .remove_file(&path)
            .at("remove", &path)
            .map(|()| there)
    }

    fn pin_path(&self, name: &str) -> std::path::PathBuf {
        self.files.root.join("pins").join(format!("{name}.json"))
    }
}
