//! `whence`: says which stage made a file, from what the file itself tells and from what the store
//! knows. Writes nothing.

use std::collections::BTreeMap;
use std::path::PathBuf;

use artifacts_schema::{Digest, Provenance};
use clap::Args;
use serde_json::{Value, json};

use super::error::Error;
use super::options::Folders;
use crate::content;
use crate::store::Store;
use crate::store::blobs::digest_file;
use crate::store::listing::{Producers, producers};
use crate::store::record::Record;
use crate::terminal::output::{flatten, print, print_json, table};

#[derive(Args)]
pub struct Whence {
    /// A file that a stage wrote, or a copy of it
    file: PathBuf,
    #[command(flatten)]
    folders: Folders,
}

/// What is known of a file.
struct Origin {
    /// What it says itself.
    told: Option<Provenance>,
    /// Its bytes' digest.
    blob: Digest,
    /// The results that it belongs to, and as which of their files.
    kept: Vec<(Record, String)>,
    /// Which stages gave which artifacts.
    producers: Producers,
}

impl Whence {
    /// Says where the file comes from.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let (blob, _) = digest_file(&self.file).map_err(|error| {
            Error::usage(
                format!("cannot read {}: {error}", self.file.display()),
                "give a file that a stage wrote",
            )
        })?;
        // The records alone: whether blobs are sound does not matter for where a file comes from.
        let records = Store::open(&self.folders.store)?.results.records()?;
        let origin = Origin {
            told: content::provenance(&self.file),
            blob,
            producers: producers(&records),
            kept: records
                .into_iter()
                .filter_map(|record| holds(record, &blob))
                .collect(),
        };
        if json {
            print_json(&origin.json());
        } else {
            print(&table(&origin.rows(), false));
        }
        if origin.told.is_some() || !origin.kept.is_empty() {
            return Ok(());
        }
        let message = format!("nothing says where {} comes from", self.file.display());
        let help = "it tells nothing itself, and the store has no file with its bytes; --store FOLDER names another store";
        Err(Error::Found {
            message,
            help: Some(help.into()),
        })
    }
}

fn holds(record: Record, blob: &Digest) -> Option<(Record, String)> {
    // By its bytes, so that a copy under any name is known as well.
    let (output, file) = record.files().find(|(_, file)| file.blob == *blob)?;
    let name = format!("{output}/{}", file.path);
    Some((record, name))
}

impl Origin {
    fn json(&self) -> Value {
        let kept = self
            .kept
            .iter()
            .map(|(record, file)| json!({"key": record.key, "stage": record.stage, "file": file}));
        let inputs: BTreeMap<_, _> = self.inputs().collect();
        json!({
            "blob": self.blob,
            "provenance": self.told,
            "inputs_from": inputs,
            "in_store": kept.collect::<Vec<_>>(),
        })
    }

    /// The stages that gave each input, as far as the store knows.
    fn inputs(&self) -> impl Iterator<Item = (&str, &str)> {
        let inputs = self.told.iter().flat_map(|told| &told.inputs);
        inputs.filter_map(|(name, digest)| {
            Some((
                name.as_str(),
                self.producers.get(&digest.parse().ok()?)?.as_str(),
            ))
        })
    }

    fn rows(&self) -> Vec<Vec<String>> {
        let mut rows = Vec::new();
        let mut row = |name: &str, text: String| rows.push(vec![name.to_owned(), text]);
        if let Some(told) = &self.told {
            row(
                "stage",
                format!(
                    "{}: {} version {}, by {}",
                    told.stage, told.kind, told.version, told.program
                ),
            );
            row("key", told.key.clone());
            row("device", told.device.clone());
            let from: BTreeMap<_, _> = self.inputs().collect();
            for (name, digest) in &told.inputs {
                let from = from
                    .get(name.as_str())
                    .map(|from| format!(" ({from})"))
                    .unwrap_or_default();
                row(&format!("inputs.{name}"), format!("{digest}{from}"));
            }
            let params = flatten("params", &told.params);
            // Inputs are fields of a stage's parameters too. They stand above already, with their
            // digests.
            let is_input = |path: &str| {
                path.strip_prefix("params.")
                    .is_some_and(|name| told.inputs.contains_key(name))
            };
            params
                .into_iter()
                .filter(|(path, _)| !is_input(path))
                .for_each(|(path, text)| row(&path, text));
        }
        for (record, file) in &self.kept {
            row(
                "in the store",
                format!("{file} of {} ({})", record.stage, record.key),
            );
        }
        rows
    }
}
