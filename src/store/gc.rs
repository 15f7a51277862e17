//! Which results nobody needs any more, and their removal: results first, then the blobs that are
//! left without one.
//!
//! What counts as needed are the last runs of each pipeline, and pins. Killed at any moment, it
//! leaves a sound store.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use artifacts_schema::Digest;
use serde::Serialize;

use super::Store;
use super::census::{Entry, age};
use super::error::{At, StoreError};
use super::files::{parent, read_json};
use super::record::Record;
use super::runs::Run;
use super::usage::{holders, sizes};

/// A blob without a result is left alone for so long: its result may be on its way, from another
/// host.
const GRACE: Duration = Duration::from_secs(3600);

/// The folder of an interrupted stage, with its checkpoints, is left alone for so long.
const INTERRUPTED: Duration = Duration::from_secs(7 * 24 * 3600);

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
    /// Its key.
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
    /// Results.
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
}

/// What the store has, and who used it.
struct Survey {
    runs: Vec<(Entry, Run)>,
    records: BTreeMap<Digest, Record>,
    pinned: BTreeSet<Digest>,
    /// The run that used each key last.
    used: BTreeMap<Digest, usize>,
}

impl Store {
    /// What goes by a policy. Changes nothing.
    pub fn garbage(&self, policy: &Policy) -> Result<Garbage, StoreError> {
        let survey = self.survey()?;
        // Two sets: a limit of size may take results of earlier runs that would otherwise be kept,
        // but never those of the latest.
        let kept = survey.of_last_runs(policy.keep_last);
        let latest = survey.of_last_runs(1);
        let mut results = self.unused(&survey, &kept, policy);
        if let Some(most) = policy.max_size {
            results.extend(survey.too_large(&results, &latest, most));
        }
        let gone: BTreeSet<Digest> = results.iter().map(|doomed| doomed.key).collect();
        let stay = sizes(
            survey
                .records
                .values()
                .filter(|record| !gone.contains(&record.key)),
        );
        let had = sizes(survey.records.values());
        let (files, _) = self.files.fanned_entries("cas")?;
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
        let others = self.others(&survey, &gone, policy)?;
        Ok(Garbage {
            results,
            blobs,
            others,
            stays: stay.values().sum(),
        })
    }

    /// Removes garbage. No other process may use the store meanwhile: see [`Store::alone`].
    pub fn remove(&self, garbage: &Garbage) -> Result<(), StoreError> {
        for doomed in &garbage.results {
            let path = self.results.path(&doomed.key);
            self.files.disk.remove_file(&path).at("remove", &path)?;
            // Before any blob goes: a loss of power must not bring back a record whose blobs are
            // gone.
            self.files.flush_folder(parent(&path))?;
        }
        // The index is only a cache; what it says of results that are gone would stay in it.
        let index = self.files.root.join("index");
        garbage
            .blobs
            .iter()
            .map(|(path, _)| path)
            .chain(&garbage.others)
            .chain([&index])
            .try_for_each(|path| {
                let is_folder = fs::symlink_metadata(path).is_ok_and(|data| data.is_dir());
                if is_folder {
                    self.files.disk.remove_folder(path)
                } else {
                    self.files.disk.remove_file(path)
                }
                .at("remove", path)
            })
    }

    fn survey(&self) -> Result<Survey, StoreError> {
        let mut runs = Vec::new();
        // Names of runs begin with the moment when they began, so the last name is the newest run.
        for entry in self.files.entries("runs")?.into_iter().rev() {
            if let Some(run) = read_json::<Run>(&entry.path)? {
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
        let pinned = self
            .pins()?
            .into_iter()
            .flat_map(|pin| pin.keys.into_values())
            .collect();
        let records = self
            .results
            .records()?
            .into_iter()
            .map(|record| (record.key, record))
            .collect();
        Ok(Survey {
            runs,
            records,
            pinned,
            used,
        })
    }

    fn unused(&self, survey: &Survey, kept: &BTreeSet<Digest>, policy: &Policy) -> Vec<Doomed> {
        let goes = |key: &&Digest| {
            // The record's own age serves where no run names the key: `pull` fetches results that
            // no run has used here.
            let age = survey
                .age(key)
                .or_else(|| age(&fs::metadata(self.results.path(key)).ok()?));
            !kept.contains(key)
                && !survey.pinned.contains(key)
                // An age that cannot be told counts as none, so that a user who asks for an age
                // keeps what is in doubt.
                && age.unwrap_or_default() >= policy.older_than
        };
        survey
            .records
            .keys()
            .filter(goes)
            .map(|key| survey.doomed(key, Why::Unused))
            .collect()
    }

    /// What goes beside results and blobs.
    fn others(
        &self,
        survey: &Survey,
        gone: &BTreeSet<Digest>,
        policy: &Policy,
    ) -> Result<Vec<PathBuf>, StoreError> {
        let mut count = BTreeMap::new();
        let mut others = Vec::new();
        // Manifests outlive their results: `explain` compares with those of earlier runs. They go
        // with the last run or pin that names them.
        let mut named = survey.pinned.clone();
        for (entry, run) in &survey.runs {
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
        others.extend(self.states_where(&|entry| match entry.digest() {
            Some(key) if survey.records.contains_key(&key) => gone.contains(&key),
            // A stage that was stopped between its last step and its result goes on from its state,
            // as others do from a checkpoint in `work`.
            _ => entry.is_older(INTERRUPTED),
        })?);
        named.extend(survey.records.keys().filter(|key| !gone.contains(key)));
        let (manifests, _) = self.files.fanned_entries("manifests")?;
        let unnamed = |entry: &Entry| {
            entry.digest().is_none_or(|key| !named.contains(&key)) && entry.is_older(GRACE)
        };
        let manifests = manifests.into_iter().filter(unnamed);
        // All of it, whatever its age: `gc` is called on purpose, and nothing else empties it.
        let quarantine = self.files.entries("quarantine")?.into_iter();
        let interrupted = self
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

impl Survey {
    /// The keys of the last runs of each pipeline.
    fn of_last_runs(&self, number: usize) -> BTreeSet<Digest> {
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
    fn too_large(&self, unused: &[Doomed], latest: &BTreeSet<Digest>, most: u64) -> Vec<Doomed> {
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
            for blob in super::usage::sizes(std::iter::once(record)).into_keys() {
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
}
