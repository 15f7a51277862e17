//! What tests of the store have in common.

use std::fs;
use std::path::{Path, PathBuf};

use artifacts_schema::{Artifact, ArtifactKind, Digest, Metrics, Provenance, Row};

use super::Store;
use super::record::Record;
use super::results::Lookup;
use super::work::{Facts, Work};

/// The digest of a word.
pub fn key(text: &str) -> Digest {
    blake3::hash(text.as_bytes()).into()
}

/// Metrics of one value.
pub fn metrics(value: f64) -> Metrics {
    let row = Row {
        mean: [("value".to_owned(), value)].into(),
        views: Default::default(),
    };
    Metrics {
        rows: [("row".to_owned(), row)].into(),
        definitions: Default::default(),
        absent: Default::default(),
    }
}

/// A result of one output.
pub fn commit(store: &Store, key: Digest, value: f64, stage: &str) -> Record {
    let work = Work::begin(store, key).unwrap().unwrap();
    let provenance = Provenance {
        stage: stage.into(),
        ..Provenance::default()
    };
    metrics(value)
        .write(&work.outputs().join("m"), &provenance)
        .unwrap();
    work.commit(&[("m", ArtifactKind::Metrics)], facts(stage), false)
        .unwrap()
}

/// What a stage says of itself.
pub fn facts(stage: &str) -> Facts {
    Facts {
        stage: stage.into(),
        seconds: 1.0,
        device: "cpu".into(),
        remarks: Vec::new(),
        peak_memory: None,
    }
}

/// Where the blob of a result lies.
pub fn blob(store: &Store, record: &Record) -> PathBuf {
    store.blobs.path(&record.outputs["m"].files[0].blob)
}

/// Damage is looked for once in a process: a new store is a new process.
pub fn lookup(folder: &Path, key: Digest) -> Lookup {
    Store::open(folder).unwrap().results.lookup(&key).unwrap()
}

/// Replaces a file, whether or not it can be written.
pub fn overwrite(path: &Path, bytes: &[u8]) {
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
}
