//! What a store has and who used it, and by that what nobody needs any more. Changes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use artifacts_schema::Digest;

use super::{Doomed, GRACE, Policy, Why};
use crate::store::error::StoreError;
use crate::store::files::read_json;
use crate::store::listing::{Entry, age};
use crate::store::pins::Pin;
use crate::store::record::Record;
use crate::store::runs::RunRecord;
use crate::store::usage::{holders, sizes};
use crate::store::{Store, state};

/// The folder of an interrupted stage, with its checkpoints, is left alone for so long.
const INTERRUPTED: Duration = Duration::from_secs(7 * 24 * 3600);

/// What the store has, and who used it.
pub(super) struct Inventory {
    runs: Vec<(Entry, RunRecord)>,
    pub(super) records: BTreeMap<Digest, Record>,
    pinned: BTreeSet<Digest>,
    /// The run that used each key last.
    used: BTreeMap<Digest, usize>,
}

impl Inventory {
    /// Reads what a store has.
    pub(super) fn of(store: &Store) -> Result<Self, StoreError> {
        let mut runs = Vec::new();
        // Names of runs begin with the moment when they began, so the last name is the newest run.
        for entry in store.files.entries("runs")?.into_iter().rev() {
            // A record of a run that is garbled names nothing to keep, as in `RunRecord::past`.
            if let Some(run) = read_json::<RunRecord>(&entry.path)? {
                runs.push((entry, run));
            }
        }
        let mut used = BTreeMap::new();
        for (at, (_, run)) in runs.iter().enumerate() {
            for key in run.stages.values().filter_map(|stage| stage.key) {
                // The newest run comes first, and the first one stays.
                used.entry(key).or_insert(at);
            }
        }
        let pinned = Pin::all(store)?
            .into_iter()
            .flat_map(|pin| pin.keys.into_values())
            .collect();
        let records = store
            .results
            .records()?
            .into_iter()
            .map(|record| (record.key, record))
            .collect();
        Ok(Self {
            runs,
            records,
            pinned,
            used,
        })
    }

    /// The keys of the last runs of each pipeline.
    pub(super) fn of_last_runs(&self, number: usize) -> BTreeSet<Digest> {
        let mut count = BTreeMap::new();
        let mut keys = BTreeSet::new();
        for (_, run) in &self.runs {
            let seen: &mut usize = count.entry(&run.pipeline).or_default();
            *seen += 1;
            if *seen <= number {
                keys.extend(run.stages.values().filter_map(|stage| stage.key));
            }
        }
        keys
    }

    /// How long ago a key was used last, as far as runs tell.
    fn age(&self, key: &Digest) -> Option<Duration> {
        age(&self.runs[*self.used.get(key)?].0.data)
    }

    fn doomed(&self, key: &Digest, why: Why) -> Doomed {
        let run = self.used.get(key).map(|&at| &self.runs[at].1);
        Doomed {
            key: *key,
            stage: self.records[key].stage.clone(),
            pipeline: run.map(|run| run.pipeline.clone()),
            used: run.map(|run| run.started.clone()),
            bytes: sizes(std::iter::once(&self.records[key])).values().sum(),
            why,
        }
    }

    /// What goes beyond `unused`, so that no more than `most` bytes stay.
    pub(super) fn too_large(
        &self,
        unused: &[Doomed],
        latest: &BTreeSet<Digest>,
        most: u64,
    ) -> Vec<Doomed> {
        let gone: BTreeSet<Digest> = unused.iter().map(|doomed| doomed.key).collect();
        let staying = || {
            self.records
                .values()
                .filter(|record| !gone.contains(&record.key))
        };
        let mut holders = holders(staying());
        let sizes = sizes(staying());
        let mut bytes: u64 = sizes.values().sum();
        // The limit on size gives way to the latest runs and to pins: nobody wants to compute again
        // what they looked at last.
        let free =
            |record: &&Record| !latest.contains(&record.key) && !self.pinned.contains(&record.key);
        let mut candidates: Vec<&Record> = staying().filter(free).collect();
        // Runs are counted from the newest on; what no run names was used before all of them.
        candidates.sort_by_key(|record| {
            (
                self.used.get(&record.key).copied().unwrap_or(usize::MAX),
                record.key,
            )
        });
        let mut doomed = Vec::new();
        while let Some(record) = candidates.pop().filter(|_| bytes > most) {
            for blob in super::sizes(std::iter::once(record)).into_keys() {
                if let Some(count) = holders.get_mut(&blob) {
                    *count -= 1;
                    // A shared blob frees no room before its last result goes.
                    bytes -= if *count == 0 { sizes[&blob] } else { 0 };
                }
            }
            doomed.push(self.doomed(&record.key, Why::TooLarge));
        }
        doomed
    }

    /// The results that nobody needs any more.
    pub(super) fn unused(
        &self,
        store: &Store,
        kept: &BTreeSet<Digest>,
        policy: &Policy,
    ) -> Vec<Doomed> {
        let goes = |key: &&Digest| {
            // The record's own age serves where no run names the key: `pull` fetches results that
            // no run has used here.
            let age = self
                .age(key)
                .or_else(|| age(&fs::metadata(store.results.path(key)).ok()?));
            !kept.contains(key)
                && !self.pinned.contains(key)
                // An age that cannot be told counts as none, so that a user who asks for an age
                // keeps what is in doubt.
                && age.unwrap_or_default() >= policy.older_than
        };
        self.records
            .keys()
            .filter(goes)
            .map(|key| self.doomed(key, Why::Unused))
            .collect()
    }

    /// What goes beside results and blobs.
    pub(super) fn others(
        &self,
        store: &Store,
        gone: &BTreeSet<Digest>,
        policy: &Policy,
    ) -> Result<Vec<PathBuf>, StoreError> {
        let mut count = BTreeMap::new();
        let mut others = Vec::new();
        // Manifests outlive their results: `explain` compares with those of earlier runs. They go
        // with the last run or pin that names them.
        let mut named = self.pinned.clone();
        for (entry, run) in &self.runs {
            let number: &mut usize = count.entry(&run.pipeline).or_default();
            *number += 1;
            if *number > policy.keep_last
                && age(&entry.data).unwrap_or_default() >= policy.older_than
            {
                others.push(entry.path.clone());
            } else {
                named.extend(run.stages.values().filter_map(|stage| stage.key));
            }
        }
        others.extend(state::going(store, &|entry| match entry.digest() {
            Some(key) if self.records.contains_key(&key) => gone.contains(&key),
            // A stage that was stopped between its last step and its result goes on from its state,
            // as others do from a checkpoint in `work`.
            _ => entry.is_older(INTERRUPTED),
        })?);
        named.extend(self.records.keys().filter(|key| !gone.contains(key)));
        let (manifests, _) = store.files.fanned_entries("manifests")?;
        let unnamed = |entry: &Entry| {
            entry.digest().is_none_or(|key| !named.contains(&key)) && entry.is_older(GRACE)
        };
        let manifests = manifests.into_iter().filter(unnamed);
        // All of it, whatever its age: `gc` is called on purpose, and nothing else empties it.
        let quarantine = store.files.entries("quarantine")?.into_iter();
        let interrupted = store
            .files
            .entries("work")?
            .into_iter()
            .filter(|entry| entry.is_older(INTERRUPTED));
        others.extend(
            manifests
                .chain(quarantine)
                .chain(interrupted)
                .map(|entry| entry.path),
        );
        Ok(others)
    }
}
