//! Results: which outputs a key has, and of which blobs they consist. A result counts only if all its blobs are there and sound.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Component, Path};

use artifacts_schema::{ArtifactKind, Digest};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::blob::Damage;
use super::error::{At, StoreError};
use super::{Store, json, read_json};

/// What a stage produced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The key of the recipe.
    pub key: Digest,
    /// The name of the stage that computed it first.
    pub stage: String,
    /// Its outputs by name.
    pub outputs: BTreeMap<String, Output>,
    /// How long it took.
    pub seconds: f64,
    /// The kind of device that it ran on.
    pub device: String,
}

/// One output artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// What it is.
    pub kind: ArtifactKind,
    /// The digest of its content, whatever its files say of their origin.
    pub digest: Digest,
    /// Its files.
    pub files: Vec<StoredFile>,
}

/// A file of an artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredFile {
    /// Its path in the artifact's folder.
    pub path: String,
    /// Its bytes.
    pub blob: Digest,
    /// How many they are.
    pub bytes: u64,
}

/// What the store has for a key.
#[derive(Debug)]
pub enum Lookup {
    /// Nothing.
    Absent,
    /// A result that cannot be used any more.
    Broken(Breakage),
    /// A whole result.
    Sound(Record),
}

/// How a result is damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Breakage {
    /// The record of the result cannot be understood.
    Record,
    /// One of its blobs is damaged.
    Blob {
        /// The file that it was: `images/view_000.exr`.
        file: String,
        /// The blob.
        blob: Digest,
        /// What is wrong with it.
        damage: Damage,
    },
}

impl fmt::Display for Breakage {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Record => f.write_str("the record of its result is damaged"),
            Self::Blob { file, damage: Damage::Missing, .. } => write!(f, "blob missing: {file}"),
            Self::Blob { file, damage: Damage::Changed, .. } => write!(f, "blob damaged: {file}"),
        }
    }
}

impl Store {
    /// Looks a key up and reads all blobs of its result through. Changes nothing.
    pub fn lookup(&self, key: &Digest) -> Result<Lookup, StoreError> {
        let path = self.result_path(key);
        let Some(record) = read_json::<Record>(&path)? else {
            return Ok(if path.exists() { Lookup::Broken(Breakage::Record) } else { Lookup::Absent });
        };
        if !record.is_of(key) {
            return Ok(Lookup::Broken(Breakage::Record));
        }
        let files: Vec<_> = record.files().collect();
        let broken = files.par_iter().map(|(output, file)| {
            let damage = self.check_blob(&file.blob)?;
            Ok(damage.map(|damage| Breakage::Blob { file: format!("{output}/{}", file.path), blob: file.blob, damage }))
        });
        let first = broken.collect::<Result<Vec<_>, StoreError>>()?.into_iter().flatten().next();
        Ok(first.map_or(Lookup::Sound(record), Lookup::Broken))
    }

    /// The keys of all results, in order.
    pub fn keys(&self) -> Result<Vec<Digest>, StoreError> {
        let folder = self.root.join("results");
        let mut keys = Vec::new();
        if !folder.exists() {
            return Ok(keys);
        }
        for entry in walkdir::WalkDir::new(&folder).min_depth(2).sort_by_file_name() {
            let entry = entry.map_err(std::io::Error::from).at("read", &folder)?;
            keys.extend(entry.path().file_stem().and_then(|stem| stem.to_str()?.parse::<Digest>().ok()));
        }
        Ok(keys)
    }

    /// Takes a result that cannot be used any more out of the store, its record first.
    pub fn discard(&self, key: &Digest, breakage: &Breakage) -> Result<(), StoreError> {
        let path = self.result_path(key);
        self.disk.remove_file(&path).at("remove", &path)?;
        match breakage {
            Breakage::Blob { blob, damage: Damage::Changed, .. } => self.quarantine(blob),
            _ => Ok(()),
        }
    }

    /// Makes a result known. If another process was first its result stays, and is the answer; `replace` overrules that.
    pub fn put_result(&self, record: Record, replace: bool) -> Result<Record, StoreError> {
        let path = self.result_path(&record.key);
        let bytes = json(&path, &record)?;
        if replace {
            self.put(&path, &bytes)?;
        } else if !self.put_new(&path, &bytes)?
            && let Lookup::Sound(first) = self.lookup(&record.key)?
        {
            return Ok(first);
        }
        Ok(record)
    }
}

impl Lookup {
    /// The result, if it is whole.
    pub fn sound(self) -> Option<Record> {
        match self {
            Self::Sound(record) => Some(record),
            Self::Absent | Self::Broken(_) => None,
        }
    }
}

impl Record {
    /// Whether this can be the record of a key: it says so, and all its files stay inside their folders.
    pub fn is_of(&self, key: &Digest) -> bool {
        self.key == *key && self.files().all(|(_, file)| is_inside(&file.path))
    }

    /// All files, with the output that each belongs to.
    pub fn files(&self) -> impl Iterator<Item = (&str, &StoredFile)> {
        self.outputs.iter().flat_map(|(name, output)| output.files.iter().map(move |file| (name.as_str(), file)))
    }
}

/// Whether a path stays inside the folder that it is relative to.
fn is_inside(path: &str) -> bool {
    !path.is_empty() && Path::new(path).components().all(|part| matches!(part, Component::Normal(_)))
}
