//! Results: which outputs a key has, and of which blobs they consist. A result counts only if all
//! its blobs are there and sound.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Component, Path};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use artifacts_schema::{ArtifactKind, Digest};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::blob::Damage;
use super::error::{At, StoreError};
use super::index::{Kind, Place};
use super::signature::Signature;
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
    /// What whoever uses it should know, a sentence each.
    #[serde(default)]
    pub remarks: Vec<String>,
    /// The most memory that the program had while it ran, in bytes, where the system tells.
    #[serde(default)]
    pub peak_memory: Option<u64>,
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
    /// What the blob looked like when this process found it as it was.
    #[serde(skip)]
    pub glance: Glance,
}

/// A look at a file, which is no part of what a record says.
#[derive(Clone, Copy, Debug, Default)]
pub struct Glance(pub(super) Option<Signature>);

impl PartialEq for Glance {
    fn eq(&self, _: &Self) -> bool {
        true
    }
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
            Self::Blob {
                file,
                damage: Damage::Missing,
                ..
            } => write!(f, "blob missing: {file}"),
            Self::Blob {
                file,
                damage: Damage::Changed,
                ..
            } => write!(f, "blob damaged: {file}"),
        }
    }
}

/// So many times what is wanted may be looked up ahead.
const AHEAD: usize = 4;

/// A sound result, as the index remembers it.
#[derive(Serialize, Deserialize)]
struct Seen {
    /// Of the record's file.
    result: Signature,
    /// Of the blobs, in the order of the files.
    blobs: Vec<Signature>,
    record: Record,
}

impl Store {
    /// Looks a key up and reads all blobs of its result through, unless that was done and nothing
    /// has changed since.
    pub fn lookup(&self, key: &Digest) -> Result<Lookup, StoreError> {
        let known = self
            .known
            .lock()
            .ok()
            .and_then(|mut known| known.remove(key));
        if let Some(record) = known.or_else(|| self.unchanged(key)) {
            return Ok(Lookup::Sound(record));
        }
        let now = SystemTime::now();
        let path = self.result_path(key);
        let result = Signature::at(&path);
        let Some(record) = read_json::<Record>(&path)? else {
            let there = fs::symlink_metadata(&path).is_ok();
            return Ok(if there {
                Lookup::Broken(Breakage::Record)
            } else {
                Lookup::Absent
            });
        };
        if !record.is_of(key) {
            return Ok(Lookup::Broken(Breakage::Record));
        }
        let files: Vec<_> = record.files().collect();
        let blobs = files
            .iter()
            .map(|(_, file)| Signature::at(&self.blob_path(&file.blob)))
            .collect();
        let broken = files.par_iter().map(|(output, file)| {
            let damage = self.check_blob(&file.blob)?;
            Ok(damage.map(|damage| Breakage::Blob {
                file: format!("{output}/{}", file.path),
                blob: file.blob,
                damage,
            }))
        });
        let first = broken
            .collect::<Result<Vec<_>, StoreError>>()?
            .into_iter()
            .flatten()
            .next();
        if let Some(breakage) = first {
            return Ok(Lookup::Broken(breakage));
        }
        if let (Some(result), Some(blobs)) = (result, blobs) {
            self.remember(
                now,
                Seen {
                    result,
                    blobs,
                    record: record.clone(),
                },
            );
        }
        Ok(Lookup::Sound(record))
    }

    /// Whether the index remembers far more results than are `wanted`.
    pub fn remembers_many(&self, wanted: usize) -> bool {
        self.index.places(Kind::Result).len() > AHEAD * wanted
    }

    /// Looks up at once what the index remembers, until there is `enough`: all threads together are
    /// faster than one key after the other.
    pub fn look_ahead(&self, enough: &AtomicBool) {
        let find = |place: &Place| {
            let seen = self
                .index
                .read(place)
                .filter(|_| !enough.load(Ordering::Relaxed));
            seen.and_then(|seen| self.confirm(seen))
                .map(|record| (record.key, record))
        };
        let found: Vec<_> = self
            .index
            .places(Kind::Result)
            .par_iter()
            .filter_map(find)
            .collect();
        if let Ok(mut known) = self.known.lock() {
            *known = found.into_iter().collect();
        }
    }

    /// A result that was found sound at an earlier time, if neither its record nor any of its blobs
    /// has changed since.
    fn unchanged(&self, key: &Digest) -> Option<Record> {
        self.confirm(self.index.get(Kind::Result, key)?)
            .filter(|record| record.key == *key)
    }

    fn confirm(
        &self,
        Seen {
            result,
            blobs,
            mut record,
        }: Seen,
    ) -> Option<Record> {
        let mut stamps = blobs.iter();
        for file in record
            .outputs
            .values_mut()
            .flat_map(|output| &mut output.files)
        {
            file.glance = Glance(Signature::at(&self.blob_path(&file.blob)));
            if file.glance.0.as_ref() != Some(stamps.next()?) {
                return None;
            }
        }
        (Signature::at(&self.result_path(&record.key)) == Some(result)).then_some(record)
    }

    /// Remembers results that this process has just written, so that the next one need not read
    /// them through: those whose blobs are still as they were written, and were left alone for long
    /// enough that it would show if they were not.
    pub fn remember_own<'r>(&self, records: impl Iterator<Item = &'r Record>) {
        let now = SystemTime::now();
        for record in records {
            let still = |file: &StoredFile| {
                Signature::at(&self.blob_path(&file.blob)).filter(|now| {
                    file.glance
                        .0
                        .is_some_and(|before| now.has_content_of(&before))
                })
            };
            let blobs = record.files().map(|(_, file)| still(file)).collect();
            if let (Some(result), Some(blobs)) =
                (Signature::at(&self.result_path(&record.key)), blobs)
            {
                self.remember(
                    now,
                    Seen {
                        result,
                        blobs,
                        record: record.clone(),
                    },
                );
            }
        }
    }

    fn remember(&self, now: SystemTime, seen: Seen) {
        if seen
            .blobs
            .iter()
            .chain([&seen.result])
            .all(|signature| signature.is_settled(now))
        {
            self.index.put(Kind::Result, &seen.record.key, &seen);
        }
    }

    /// The keys of all results, in order.
    pub fn keys(&self) -> Result<Vec<Digest>, StoreError> {
        let folder = self.root.join("results");
        let mut keys = Vec::new();
        if !folder.exists() {
            return Ok(keys);
        }
        for entry in walkdir::WalkDir::new(&folder)
            .min_depth(2)
            .sort_by_file_name()
        {
            let entry = entry.map_err(std::io::Error::from).at("read", &folder)?;
            keys.extend(
                entry
                    .path()
                    .file_stem()
                    .and_then(|stem| stem.to_str()?.parse::<Digest>().ok()),
            );
        }
        Ok(keys)
    }

    /// Takes a result that cannot be used any more out of the store, its record first.
    pub fn discard(&self, key: &Digest, breakage: &Breakage) -> Result<(), StoreError> {
        self.set_aside(&self.result_path(key))?;
        match breakage {
            Breakage::Blob {
                blob,
                damage: Damage::Changed,
                ..
            } => self.set_aside(&self.blob_path(blob)),
            _ => Ok(()),
        }
    }

    /// Makes a result known. If another process was first its result stays, and is the answer;
    /// `replace` overrules that.
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
    /// Whether this can be the record of a key: it says so, and all its files stay inside their
    /// folders.
    pub fn is_of(&self, key: &Digest) -> bool {
        self.key == *key && self.files().all(|(_, file)| is_inside(&file.path))
    }

    /// All files, with the output that each belongs to.
    pub fn files(&self) -> impl Iterator<Item = (&str, &StoredFile)> {
        self.outputs
            .iter()
            .flat_map(|(name, output)| output.files.iter().map(move |file| (name.as_str(), file)))
    }
}

/// Whether a path stays inside the folder that it is relative to.
pub(super) fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && Path::new(path)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
}
