//! Why a stage has the key that it has and not the one it had: manifests compared, entry by entry.
//! Computes nothing.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::OnceLock;

use artifacts_schema::Digest;
use serde::Serialize;

use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::manifest::Manifest;
use crate::store::results::Breakage;
use crate::store::runs::RunRecord;

/// How many runs back to look.
const RUNS: usize = 16;

/// An entry of a manifest that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Change {
    /// The entry, as in [`Manifest`].
    pub path: String,
    /// Its text before; `None` where there was none.
    pub before: Option<String>,
    /// Its text now; `None` where there is none.
    pub now: Option<String>,
    /// Of an input: the stage that it comes from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
}

impl Change {
    /// The input that differs, if it is one.
    pub fn input(&self) -> Option<&str> {
        self.path.strip_prefix("inputs.")
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let name = self.path.strip_prefix("params.").unwrap_or(&self.path);
        let text = |side: &Option<String>| side.as_deref().map_or("nothing".to_owned(), short);
        match (self.input(), &self.from) {
            (Some(input), Some(from)) => write!(f, "input `{input}` (of {from}) changed"),
            (Some(input), None) => write!(f, "input `{input}` changed"),
            (None, _) => write!(f, "`{name}` {} -> {}", text(&self.before), text(&self.now)),
        }
    }
}

/// A digest by its first digits, anything else as it is.
fn short(text: &str) -> String {
    if text.parse::<Digest>().is_ok() {
        // Twelve digits are 48 bits: two of a user's results will not share them.
        text[..12].to_owned()
    } else {
        text.to_owned()
    }
}

/// Why a stage must be computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// No stage of this name has run here.
    New,
    /// It ran with other parameters, inputs or code.
    Changed(Vec<Change>),
    /// It ran just so, but its result is gone.
    Lost,
    /// Its result is damaged.
    Broken(Breakage),
    /// The user wants it.
    Forced,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::New => f.write_str("new"),
            Self::Changed(changes) => f.write_str(&sentence(changes)),
            Self::Lost => f.write_str("its result is gone"),
            Self::Broken(breakage) => breakage.fmt(f),
            Self::Forced => f.write_str("forced"),
        }
    }
}

/// `params changed: lora_every 1 -> 3; input images changed`.
fn sentence(changes: &[Change]) -> String {
    let (params, others): (Vec<&Change>, Vec<&Change>) =
        changes.iter().partition(|c| c.path.starts_with("params."));
    let list = |changes: &[&Change]| {
        changes
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(", ")
    };
    let mut parts = Vec::new();
    if !params.is_empty() {
        parts.push(format!("params changed: {}", list(&params)));
    }
    if !others.is_empty() {
        parts.push(list(&others));
    }
    parts.join("; ")
}

/// All entries that differ between two manifests, in order. Inputs that are not known `now` are
/// left out.
pub fn diff(before: &Manifest, now: &Manifest, unknown: &BTreeSet<&str>) -> Vec<Change> {
    let paths: BTreeSet<&String> = before.0.keys().chain(now.0.keys()).collect();
    // An input that has yet to be computed is no difference. Only what is known can be compared.
    let known = |path: &&String| {
        path.strip_prefix("inputs.")
            .is_none_or(|input| !unknown.contains(input))
    };
    let change = |path: &String| Change {
        path: path.clone(),
        before: before.0.get(path).cloned(),
        now: now.0.get(path).cloned(),
        from: None,
    };
    paths
        .into_iter()
        .filter(known)
        .map(change)
        .filter(|change| change.before != change.now)
        .collect()
}

/// The latest runs of a pipeline, read when first asked for.
pub struct History<'s> {
    store: &'s Store,
    pipeline: String,
    runs: OnceLock<Vec<RunRecord>>,
}

/// What a stage was in an earlier run.
#[derive(Clone, Debug)]
pub struct Past {
    /// When that run began.
    pub started: String,
    pub key: Digest,
    pub manifest: Manifest,
}

impl<'s> History<'s> {
    /// The runs of a pipeline.
    pub fn new(store: &'s Store, pipeline: &str) -> Self {
        Self {
            store,
            pipeline: pipeline.to_owned(),
            runs: OnceLock::new(),
        }
    }

    fn runs(&self) -> Result<&[RunRecord], StoreError> {
        // `get_or_init` takes no function that can fail, so reading comes first.
        if self.runs.get().is_none() {
            let runs = RunRecord::past(self.store, Some(&self.pipeline))?
                .take(RUNS)
                .collect();
            return Ok(self.runs.get_or_init(|| runs));
        }
        Ok(self.runs.get().map(Vec::as_slice).unwrap_or_default())
    }

    /// What a stage was in earlier runs, newest first, each key once.
    pub fn past(&self, stage: &str) -> Result<Vec<Past>, StoreError> {
        let mut seen = BTreeSet::new();
        let mut past = Vec::new();
        for run in self.runs()? {
            let key = run
                .stages
                .get(stage)
                .and_then(|stage| stage.key)
                // Most runs find a stage as it was: each of its keys is compared once.
                .filter(|key| seen.insert(*key));
            let manifest = key.and_then(|key| self.store.manifests.get(&key));
            if let (Some(key), Some(manifest)) = (key, manifest) {
                past.push(Past {
                    started: run.started.clone(),
                    key,
                    manifest,
                });
            }
        }
        Ok(past)
    }

    /// The earlier manifest that differs least from this one, the newest of several.
    pub fn nearest(
        &self,
        stage: &str,
        now: &Manifest,
        unknown: &BTreeSet<&str>,
    ) -> Result<Option<Past>, StoreError> {
        Ok(self
            .past(stage)?
            .into_iter()
            // `min_by_key` takes the first of several, which is the newest.
            .min_by_key(|past| diff(&past.manifest, now, unknown).len()))
    }

    /// The same, of those that differ at all.
    pub fn nearest_other(
        &self,
        stage: &str,
        key: &Digest,
        now: &Manifest,
    ) -> Result<Option<Past>, StoreError> {
        let others = self
            .past(stage)?
            .into_iter()
            .filter(|past| past.key != *key);
        Ok(others.min_by_key(|past| diff(&past.manifest, now, &BTreeSet::new()).len()))
    }

    /// What a stage was in the run that began at this moment.
    pub fn at(&self, started: &str, stage: &str) -> Result<Option<Past>, StoreError> {
        let run = self.runs()?.iter().find(|run| run.started == started);
        let key = run
            .and_then(|run| run.stages.get(stage))
            .and_then(|stage| stage.key);
        let past = |key: Digest| {
            self.store.manifests.get(&key).map(|manifest| Past {
                started: started.to_owned(),
                key,
                manifest,
            })
        };
        Ok(key.and_then(past))
    }
}
