//! What takes the space of a store: whose blobs there are, and which are shared. Changes nothing.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;

use super::Store;
use super::error::StoreError;
use super::record::Record;
use super::runs::RunRecord;

/// The blobs of some results, against all others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Space {
    /// Bytes of all their blobs, each counted once.
    pub bytes: u64,
    /// Those of blobs that no other stage, pipeline or earlier run shares.
    pub own: u64,
}

/// The space that stages take.
pub struct Usage {
    /// By pipeline and stage, of the last run of each pipeline.
    pub stages: Vec<(String, String, Space)>,
    /// Of each pipeline as a whole.
    pub pipelines: BTreeMap<String, Space>,
    /// Of results that no last run has.
    pub others: Space,
    /// Of blobs that no result has, and of everything that is no blob.
    pub rest: BTreeMap<&'static str, u64>,
    /// Of everything.
    pub total: u64,
}

impl Usage {
    /// Measures everything.
    pub fn of(store: &Store) -> Result<Self, StoreError> {
        let records: BTreeMap<Digest, Record> = store
            .results
            .records()?
            .into_iter()
            .map(|record| (record.key, record))
            .collect();
        let mut runs: BTreeMap<String, Vec<(String, Digest)>> = BTreeMap::new();
        for run in RunRecord::past(store, None)? {
            let keys = run
                .stages
                .into_iter()
                .filter_map(|(stage, run)| Some((stage, run.key?)));
            // Runs come newest first, so that the first of each pipeline is its last run.
            runs.entry(run.pipeline).or_insert_with(|| keys.collect());
        }
        let record = |(_, key): &(String, Digest)| records.get(key);
        let named: BTreeSet<Digest> = runs.values().flatten().map(|(_, key)| *key).collect();
        let unnamed = records
            .values()
            .filter(|record| !named.contains(&record.key));
        // A result that several stages use is held by each.
        let holders = holders(
            runs.values()
                .flatten()
                .filter_map(record)
                .chain(unnamed.clone()),
        );
        let mut stages = Vec::new();
        let mut pipelines = BTreeMap::new();
        for (pipeline, keys) in &runs {
            let of = |stage: &(String, Digest)| {
                (
                    pipeline.clone(),
                    stage.0.clone(),
                    space(record(stage).into_iter(), &holders),
                )
            };
            stages.extend(keys.iter().map(of));
            pipelines.insert(
                pipeline.clone(),
                space(keys.iter().filter_map(record), &holders),
            );
        }
        let others = space(unnamed, &holders);
        let rest = self::rest(store, &records)?;
        let blobs: u64 = sizes(records.values()).values().sum();
        let total = blobs + rest.values().sum::<u64>();
        Ok(Self {
            stages,
            pipelines,
            others,
            rest,
            total,
        })
    }
}

/// What is no blob of a result.
fn rest(
    store: &Store,
    records: &BTreeMap<Digest, Record>,
) -> Result<BTreeMap<&'static str, u64>, StoreError> {
    let known = sizes(records.values());
    let (blobs, _) = store.files.fanned_entries("cas")?;
    let orphans = blobs
        .iter()
        .filter(|entry| entry.digest().is_none_or(|blob| !known.contains_key(&blob)));
    let mut rest = BTreeMap::from([(
        "blobs of no result",
        orphans.map(|entry| entry.data.len()).sum(),
    )]);
    for (name, folder) in [
        ("interrupted stages", "work"),
        ("quarantine", "quarantine"),
        ("states for longer runs", "states"),
    ] {
        rest.insert(name, size_of(&store.files.root.join(folder)));
    }
    let records: u64 = ["results", "manifests", "runs", "pins"]
        .map(|folder| size_of(&store.files.root.join(folder)))
        .iter()
        .sum();
    rest.insert("records", records);
    Ok(rest)
}

/// The sizes of all blobs of some results.
pub(super) fn sizes<'r>(records: impl Iterator<Item = &'r Record>) -> BTreeMap<Digest, u64> {
    records
        .flat_map(Record::files)
        // A map, so that a blob that several files share counts once.
        .map(|(_, file)| (file.blob, file.bytes))
        .collect()
}

/// How many of some results have each blob.
pub(super) fn holders<'r>(records: impl Iterator<Item = &'r Record>) -> BTreeMap<Digest, usize> {
    let mut holders = BTreeMap::new();
    for record in records {
        // By way of `sizes`: two equal files of one result are one holder.
        for blob in sizes(std::iter::once(record)).into_keys() {
            *holders.entry(blob).or_default() += 1;
        }
    }
    holders
}

fn space<'r>(
    records: impl Iterator<Item = &'r Record> + Clone,
    holders: &BTreeMap<Digest, usize>,
) -> Space {
    // A blob is their own if nobody else holds it: all its holders are among these.
    let within = self::holders(records.clone());
    let sizes = sizes(records);
    let own = sizes
        .iter()
        .filter(|(blob, _)| within[*blob] == holders[*blob])
        .map(|(_, bytes)| bytes)
        .sum();
    Space {
        bytes: sizes.values().sum(),
        own,
    }
}

fn size_of(folder: &std::path::Path) -> u64 {
    let files = walkdir::WalkDir::new(folder)
        .into_iter()
        .flatten()
        .filter(|entry| entry.file_type().is_file());
    files
        .filter_map(|entry| entry.metadata().ok())
        .map(|data| data.len())
        .sum()
}
