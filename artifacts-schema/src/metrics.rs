//! Scores: `metrics.json`, one row per arm, each with a mean and the values per view.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::Provenance;

const FILE: &str = "metrics.json";

/// Scores. All are finite numbers: where a metric has no value, leave it out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metrics {
    /// What was scored, by name: an arm, a baseline.
    pub rows: BTreeMap<String, Row>,
    /// What each metric is, by name: its definition, range and which way is better (`higher is`,
    /// `lower is`).
    pub definitions: BTreeMap<String, String>,
    /// Why a row has no value of a metric that was asked for: by row, then by metric.
    pub absent: BTreeMap<String, BTreeMap<String, String>>,
}

/// The scores of one thing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Row {
    /// The mean over all views, by metric.
    pub mean: BTreeMap<String, f64>,
    /// The values by view, then by metric.
    pub views: BTreeMap<String, BTreeMap<String, f64>>,
}

/// The file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(crate) struct MetricsFile {
    rows: BTreeMap<String, Row>,
    definitions: BTreeMap<String, String>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    absent: BTreeMap<String, BTreeMap<String, String>>,
    provenance: Provenance,
}

impl Metrics {
    fn check(&self) -> Result<(), SchemaError> {
        for (name, row) in &self.rows {
            // JSON would turn what is not finite into null, which does not read back.
            check_scores(&row.mean, || format!("row {name:?}, mean"))?;
            for (view, scores) in &row.views {
                check_scores(scores, || format!("row {name:?}, view {view:?}"))?;
            }
        }
        Ok(())
    }
}

fn check_scores(
    scores: &BTreeMap<String, f64>,
    place: impl Fn() -> String,
) -> Result<(), SchemaError> {
    match scores.iter().find(|(_, score)| !score.is_finite()) {
        Some((metric, score)) => {
            let problem = format!(
                "is {score}; JSON holds finite numbers only, leave out a metric without a value"
            );
            Err(SchemaError::content(
                format!("{}: {metric}", place()),
                problem,
            ))
        }
        None => Ok(()),
    }
}

impl Artifact for Metrics {
    const KIND: ArtifactKind = ArtifactKind::Metrics;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.check()?;
        let page = canonical::page(&MetricsFile {
            rows: self.rows.clone(),
            definitions: self.definitions.clone(),
            absent: self.absent.clone(),
            provenance: provenance.clone(),
        })?;
        canonical::write(folder, FILE, page.as_bytes())
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let MetricsFile {
            rows,
            definitions,
            absent,
            ..
        } = canonical::read(&folder.join(FILE))?;
        Ok(Self {
            rows,
            definitions,
            absent,
        })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.count(self.rows.len());
        for (name, row) in &self.rows {
            hasher.text(name);
            hasher.scores(&row.mean);
            hasher.count(row.views.len());
            for (view, scores) in &row.views {
                hasher.text(view);
                hasher.scores(scores);
            }
        }
        // Definitions belong to the content: by another one the same number says something else.
        hasher.count(self.definitions.len());
        for (metric, definition) in &self.definitions {
            hasher.text(metric);
            hasher.text(definition);
        }
        // Metrics that lack nothing keep the digest that they had before there was anything to
        // lack.
        for (row, reasons) in &self.absent {
            hasher.text(row);
            hasher.count(reasons.len());
            for (metric, reason) in reasons {
                hasher.text(metric);
                hasher.text(reason);
            }
        }
        hasher.finish()
    }
}
