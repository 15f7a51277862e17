//! Results: which outputs a key has, and of which blobs they consist. A result counts only if all
//! its blobs are there and sound.

mod known;

use std::fmt;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use artifacts_schema::Digest;
use rayon::prelude::*;

use super::blobs::{Blobs, Damage};
use super::cache::Cache;
use super::cache::signature::Signature;
use super::error::{At, StoreError};
use super::files::{Files, json, read_json};
use super::listing::Entry;
use super::record::Record;
use known::Known;

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

/// The results of a store.
pub struct Results {
    files: Arc<Files>,
    blobs: Arc<Blobs>,
    /// Those that were found sound.
    pub known: Known,
}

impl Results {
    pub(super) fn new(files: Arc<Files>, blobs: Arc<Blobs>, cache: Arc<Cache>) -> Self {
        Self {
            known: Known::new(files.clone(), blobs.clone(), cache),
            files,
            blobs,
        }
    }

    /// Where the record of a key lies.
    pub fn path(&self, key: &Digest) -> PathBuf {
        path(&self.files, key)
    }

    /// Looks a key up and reads all blobs of its result through, unless that was done and nothing
    /// has changed since.
    pub fn lookup(&self, key: &Digest) -> Result<Lookup, StoreError> {
        if let Some(record) = self.known.get(key) {
            return Ok(Lookup::Sound(record));
        }
        // The time and the signatures are taken before anything is read. A file that changes during
        // the reading then has another signature, and is not taken for what was read.
        let now = self.known.now();
        let path = self.path(key);
        let result = Signature::at(&path);
        let Some(record) = read_json::<Record>(&path)? else {
            // Without following links: a link that leads nowhere is damage to be moved away, not an
            // absent result.
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
            .map(|(_, file)| Signature::at(&self.blobs.path(&file.blob)))
            .collect();
        let broken = files.par_iter().map(|(output, file)| {
            let damage = self.blobs.check(&file.blob)?;
            Ok(damage.map(|damage| Breakage::Blob {
                file: format!("{output}/{}", file.path),
                blob: file.blob,
                damage,
            }))
        });
        // The first in the order of the record, not the first that a thread came upon: the message
        // is the same each time.
        let first = broken
            .collect::<Result<Vec<_>, StoreError>>()?
            .into_iter()
            .flatten()
            .next();
        if let Some(breakage) = first {
            return Ok(Lookup::Broken(breakage));
        }
        self.known.remember(now, &record, result, blobs);
        Ok(Lookup::Sound(record))
    }

    /// All records of results that can be understood, by key. Their blobs are not looked at.
    pub fn records(&self) -> Result<Vec<Record>, StoreError> {
        let (files, _) = self.files.fanned_entries("results")?;
        let read = |entry: &Entry| {
            Ok(read_json::<Record>(&entry.path)?
                // A record that lies under another key is damage, and counts for nothing.
                .filter(|record| Some(record.key) == entry.digest()))
        };
        files
            .par_iter()
            .map(read)
            .filter_map(Result::transpose)
            .collect()
    }

    /// The record of a key, if there is one that can be understood. Its blobs are not looked at.
    pub fn record(&self, key: &Digest) -> Option<Record> {
        // For what only wants to tell something of a result: a record that cannot be read is as
        // good as none there.
        let record = read_json::<Record>(&self.path(key)).ok().flatten()?;
        record.is_of(key).then_some(record)
    }

    /// The keys of all results, in order.
    pub fn keys(&self) -> Result<Vec<Digest>, StoreError> {
        let folder = self.files.root.join("results");
        let mut keys = Vec::new();
        if !folder.exists() {
            return Ok(keys);
        }
        for entry in walkdir::WalkDir::new(&folder)
            // The first level are the folders `00` to `ff`.
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
        // With the record gone first, a process that stops in between leaves no result that lacks a
        // blob.
        self.files.set_aside(&self.path(key))?;
        match breakage {
            Breakage::Blob {
                blob,
                damage: Damage::Changed,
                ..
            } => self.files.set_aside(&self.blobs.path(blob)),
            // A missing blob leaves nothing to move, and a damaged record names no blobs.
            _ => Ok(()),
        }
    }

    /// Makes a result known. If another process was first its result stays, and is the answer;
    /// `replace` overrules that.
    pub fn put(&self, record: Record, replace: bool) -> Result<Record, StoreError> {
        let path = self.path(&record.key);
        let bytes = json(&path, &record)?;
        // Who forces a stage wants the new bits. Otherwise the first result stays, since others may
        // be reading it already.
        if !replace {
            if self.files.put_new(&path, &bytes)? {
                return Ok(record);
            }
            if let Lookup::Sound(first) = self.lookup(&record.key)? {
                return Ok(first);
            }
            // What is there is no result, and came there since the stage began.
            self.files.set_aside(&path)?;
        }
        self.files.put(&path, &bytes)?;
        Ok(record)
    }
}

fn path(files: &Files, key: &Digest) -> PathBuf {
    files.fanned("results", key, ".json")
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

#[cfg(test)]
mod tests;
