//! Tables of metrics and paths of comparison pictures, from results in the store.

use std::collections::BTreeSet;

use artifacts_schema::{Artifact, ArtifactKind, Log, Metrics};

use crate::store::Store;
use crate::store::error::{At, StoreError};
use crate::store::record::{Output, Record};
use crate::store::view::View;
use crate::terminal::output::table;
use crate::terminal::progress::figure;

/// A metrics artifact of a stage.
pub struct Scores {
    pub stage: String,
    pub output: String,
    /// The scores.
    pub metrics: Metrics,
}

/// All metrics artifacts of a result.
pub fn scores(store: &Store, stage: &str, record: &Record) -> Result<Vec<Scores>, StoreError> {
    let of_kind = record
        .outputs
        .iter()
        .filter(|(_, output)| output.kind == ArtifactKind::Metrics);
    of_kind
        .map(|(name, output)| {
            Ok(Scores {
                stage: stage.to_owned(),
                output: name.clone(),
                metrics: read(store, name, output)?,
            })
        })
        .collect()
}

fn read(store: &Store, name: &str, output: &Output) -> Result<Metrics, StoreError> {
    let folder = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
    output.show(store, folder.path())?;
    Metrics::read(folder.path()).map_err(|error| StoreError::Output {
        output: name.to_owned(),
        problem: error.to_string(),
    })
}

/// The log of a result; empty where it has none, or one that cannot be read: `store fsck` is for
/// finding out why.
pub fn log(store: &Store, record: &Record) -> Result<Log, StoreError> {
    let log = record.outputs.get("log");
    let Some(output) = log.filter(|output| output.kind == ArtifactKind::Log) else {
        return Ok(Log::default());
    };
    let folder = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
    output.show(store, folder.path())?;
    Ok(Log::read(folder.path()).unwrap_or_default())
}

/// Whether a result has tables, figures or remarks.
pub fn tells(record: &Record) -> bool {
    let has_remarks = !record.remarks.is_empty();
    // A run that finds all results cached reads back only those that this names: whatever it
    // prints of a result has to count here.
    let shows = record
        .outputs
        .values()
        .any(|output| matches!(output.kind, ArtifactKind::Metrics | ArtifactKind::Figures));
    has_remarks || shows
}

/// The tables of all metrics artifacts of a result.
pub fn tables(store: &Store, stage: &str, record: &Record) -> Result<Vec<String>, StoreError> {
    Ok(scores(store, stage, record)?
        .iter()
        .map(Scores::table)
        .collect())
}

impl Scores {
    /// Rows by metrics, the mean over views; the most telling metric first.
    pub fn table(&self) -> String {
        let Metrics {
            rows, definitions, ..
        } = &self.metrics;
        // Definitions too: a metric that no row has still shows, with dashes.
        let names: BTreeSet<&String> = definitions
            .keys()
            .chain(rows.values().flat_map(|row| row.mean.keys()))
            .collect();
        let mut names = Vec::from_iter(names);
        // The sort is stable: those of unknown rank stay in the order of their names.
        names.sort_by_key(|name| stages::metric_rank(name));
        let head = std::iter::once(self.stage.clone())
            .chain(names.iter().map(|name| (*name).clone()))
            .collect();
        let lines = rows.iter().map(|(row, scores)| {
            let cell = |name: &&String| {
                scores
                    .mean
                    .get(*name)
                    .map_or("-".to_owned(), |value| figure(*value))
            };
            std::iter::once(row.clone())
                .chain(names.iter().map(cell))
                .collect()
        });
        table(
            &std::iter::once(head).chain(lines).collect::<Vec<_>>(),
            true,
        )
    }
}

/// The most pictures of an output that are named one by one: a film has hundreds.
const NAMED: usize = 12;

/// Where people find the pictures of a result: the files, or, of many, their folder. Of several
/// outputs of pictures the first has the files, and the others their folders.
pub fn figures(view: &View, stage: &str, record: &Record) -> Vec<String> {
    let of_kind = record
        .outputs
        .iter()
        .filter(|(_, output)| output.kind == ArtifactKind::Figures);
    let pictures = |(at, (name, output)): (usize, (&String, &Output))| {
        let folder = view.output(stage, name);
        let files: Vec<_> = output
            .files
            .iter()
            .filter(|file| file.path.ends_with(".png"))
            .collect();
        match files.len() {
            0..=NAMED if at == 0 => files
                .iter()
                .map(|file| folder.join(&file.path).display().to_string())
                .collect(),
            _ => vec![folder.display().to_string()],
        }
    };
    of_kind.enumerate().flat_map(pictures).collect()
}
