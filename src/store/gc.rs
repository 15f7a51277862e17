//! Which results nobody needs any more, and their removal: results first, then the blobs that are
//! left without one.
//!
//! What counts as needed are the last runs of each pipeline, and pins. Killed at any moment, it
//! leaves a sound store.

mod inventory;

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use artifacts_schema::Digest;
use serde::Serialize;

use super::Store;
use super::error::{At, StoreError};
use super::files::parent;
use super::listing::Entry;
use super::usage::sizes;
use inventory::Inventory;

/// A blob without a result is left alone for so long: its result may be on its way, from another
/// host.
const GRACE: Duration = Duration::from_secs(3600);

/// What to keep.
#[derive(Clone, Copy, Debug)]
pub struct Policy {
    /// How many runs of each pipeline.
    pub keep_last: usize,
    /// Whatever was used more recently than this.
    pub older_than: Duration,
    /// How many bytes of results at most; what was not used for longest goes first, the last runs
    /// and pins never.
    pub max_size: Option<u64>,
}

/// Why something goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// No run that is kept used it, and no pin holds it.
    Unused,
    /// The store is too large.
    TooLarge,
}

/// A result that goes.
#[derive(Clone, Debug, Serialize)]
pub struct Doomed {
    pub key: Digest,
    /// The stage that computed it first.
    pub stage: String,
    /// The pipeline that used it last, if that is known.
    pub pipeline: Option<String>,
    /// When that run began.
    pub used: Option<String>,
    /// Bytes of its blobs, those included that others share.
    pub bytes: u64,
    /// Why it goes.
    pub why: Why,
}

/// Everything that goes.
#[derive(Debug, Default)]
pub struct Garbage {
    pub results: Vec<Doomed>,
    /// Blobs that no result has then, and their bytes.
    pub blobs: Vec<(PathBuf, u64)>,
    /// Other files and folders: records of runs, manifests, states, what is in quarantine,
    /// interrupted stages.
    pub others: Vec<PathBuf>,
    /// The bytes of blobs that stay.
    pub stays: u64,
}

impl Garbage {
    /// The bytes of blobs that go.
    pub fn bytes(&self) -> u64 {
        self.blobs.iter().map(|(_, bytes)| bytes).sum()
    }

    /// Whether nothing goes.
    pub fn is_empty(&self) -> bool {
        self.results.is_empty() && self.blobs.is_empty() && self.others.is_empty()
    }

    /// What goes by a policy. Changes nothing.
    pub fn of(store: &Store, policy: &Policy) -> Result<Self, StoreError> {
        let inventory = Inventory::of(store)?;
        // Two sets: a limit of size may take results of earlier runs that would otherwise be kept,
        // but never those of the latest.
        let kept = inventory.of_last_runs(policy.keep_last);
        let latest = inventory.of_last_runs(1);
        let mut results = inventory.unused(store, &kept, policy);
        if let Some(most) = policy.max_size {
            results.extend(inventory.too_large(&results, &latest, most));
        }
        let gone: BTreeSet<Digest> = results.iter().map(|doomed| doomed.key).collect();
        let stay = sizes(
            inventory
                .records
                .values()
                .filter(|record| !gone.contains(&record.key)),
        );
        let had = sizes(inventory.records.values());
        let (files, _) = store.files.fanned_entries("cas")?;
        let goes = |entry: &Entry| match entry.digest() {
            // Several results can share a blob: it goes with the last of them.
            Some(blob) if stay.contains_key(&blob) => false,
            // Its result goes too, so no other host is about to commit it and the hour of grace is
            // not needed.
            Some(blob) if had.contains_key(&blob) => true,
            _ => entry.is_older(GRACE),
        };
        let blobs = files
            .into_iter()
            .filter(goes)
            .map(|entry| (entry.path, entry.data.len()))
            .collect();
        let others = inventory.others(store, &gone, policy)?;
        Ok(Self {
            results,
            blobs,
            others,
            stays: stay.values().sum(),
        })
    }

    /// Removes it. No other process may use the store meanwhile: see [`Store::alone`].
    pub fn remove(&self, store: &Store) -> Result<(), StoreError> {
        for doomed in &self.results {
            let path = store.results.path(&doomed.key);
            store.files.disk.remove_file(&path).at("remove", &path)?;
            // Before any blob goes: a loss of power must not bring back a record whose blobs are
            // gone.
            store.files.flush_folder(parent(&path))?;
        }
        // The index is only a cache; what it says of results that are gone would stay in it.
        let index = store.files.root.join("index");
        self.blobs
            .iter()
            .map(|(path, _)| path)
            .chain(&self.others)
            .chain([&index])
            .try_for_each(|path| {
                let is_folder = fs::symlink_metadata(path).is_ok_and(|data| data.is_dir());
                if is_folder {
                    store.files.disk.remove_folder(path)
                } else {
                    store.files.disk.remove_file(path)
                }
                .at("remove", path)
            })
    }
}
