//! What stages will take, foretold: from the latest result of their kind that is most like them, or where
//! there is none from the stage's own estimate. Decides nothing, and knows nothing of what runs
//! beside what.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use stages::{Estimate, Extension};

use super::sizes::Expected;
use super::{Context, Inputs};
use crate::pipeline::graph::Node;
use crate::runner::explain::{Change, diff};
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::manifest::Manifest;
use crate::store::runs::RunRecord;

/// How many runs back results are looked for, how many results are looked at, and how many of a kind
/// are kept: a plan of thousands of stages compares each with these.
const RUNS: usize = 16;
const RESULTS: usize = 2000;
const KEPT: usize = 16;
/// A result tells nothing if it took so many times less memory than is estimated now: its photos
/// were far smaller.
const FAR: u64 = 8;
/// How parameters' entries begin.
const PARAMETERS: &str = "params.";

/// What a stage will take.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    pub seconds: f64,
    /// Bytes of main memory at the worst moment. Of an earlier result it is what the whole program
    /// had then, with what ran beside it.
    pub memory: u64,
    /// How that is known.
    pub basis: Basis,
}

/// How it is known what a stage will take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Basis {
    /// A result of the same kind and parameters took so much.
    Result {
        /// The stage that it was of.
        stage: String,
    },
    /// A result of the same kind took so much, whose parameters differ in these. Time is in
    /// proportion to the steps.
    Like {
        /// The stage that it was of.
        stage: String,
        /// The parameters.
        but: Vec<String>,
    },
    /// No such result is known: the stage's own estimate, by its parameters and the sizes of what
    /// it reads.
    Guess,
}

/// What the latest results took, by kind, the newest first.
#[derive(Default)]
pub struct Experience {
    by_kind: BTreeMap<String, Vec<Known>>,
}

/// A result.
struct Known {
    stage: String,
    manifest: Manifest,
    seconds: f64,
    memory: Option<u64>,
}

impl Experience {
    /// Of the last runs of a store, whichever pipelines they were of.
    pub fn of(store: &Store) -> Result<Self, StoreError> {
        let mut seen = BTreeSet::new();
        let runs = RunRecord::past(store, None)?.take(RUNS);
        let stages = runs.flat_map(|run| run.stages);
        let keys = stages.filter_map(|(stage, was)| Some((stage, was.key?)));
        // The same result is in many runs: it is read once.
        let results = keys.filter(|(_, key)| seen.insert(*key)).take(RESULTS);
        let mut experience = Self::default();
        results
            .filter_map(|(stage, key)| Known::of(store, stage, &key))
            .for_each(|known| experience.keep(known));
        Ok(experience)
    }

    /// Keeps a result, unless a newer one was of the same stage and parameters.
    fn keep(&mut self, known: Known) {
        let Some(kind) = known.manifest.0.get("kind") else {
            return;
        };
        let kept = self.by_kind.entry(kind.clone()).or_default();
        let is_old = kept.iter().any(|newer| known.is_like(newer));
        // The newest come first, so what is kept is the latest of each.
        if kept.len() < KEPT && !is_old {
            kept.push(known);
        }
    }

    /// The result most like a stage, and the parameters in which it differs: of several that of a
    /// stage of its name, and of those the newest.
    fn nearest(&self, node: &Node, manifest: &Manifest) -> Option<(&Known, Vec<Change>)> {
        let known = self.by_kind.get(node.stage.kind())?.iter();
        // Another device has another pace.
        let device = |manifest: &Manifest| manifest.0.get("device").cloned();
        let comparable = known.filter(|known| device(&known.manifest) == device(manifest));
        let beside = comparable.map(|known| (known, parameters(&known.manifest, manifest)));
        // `min_by_key` takes the first of several, which is the newest.
        beside.min_by_key(|(known, changes)| (changes.len(), known.stage != node.name))
    }
}

impl Known {
    fn of(store: &Store, stage: String, key: &Digest) -> Option<Self> {
        let record = store.results.record(key)?;
        Some(Self {
            stage,
            manifest: store.manifests.get(key)?,
            seconds: record.seconds,
            memory: record.peak_memory,
        })
    }

    fn is_like(&self, other: &Self) -> bool {
        let told = |known: &Self| {
            let entries = known.manifest.0.clone().into_iter();
            entries
                // Inputs and seeds are left out: they tell nothing of cost.
                .filter(|(path, _)| path.starts_with(PARAMETERS) || path == "device")
                .collect::<Vec<_>>()
        };
        self.stage == other.stage && told(self) == told(other)
    }
}

/// The parameters that differ. What a stage reads tells less of its cost than they do, and is not
/// known before others have run.
fn parameters(before: &Manifest, now: &Manifest) -> Vec<Change> {
    let changes = diff(before, now, &BTreeSet::new()).into_iter();
    changes
        .filter(|change| change.path.starts_with(PARAMETERS))
        .collect()
}

impl Context<'_> {
    /// What a stage will take that reads what is expected.
    pub fn cost(&self, at: usize, experience: &Experience, expected: &Expected) -> Cost {
        let node = &self.graph.nodes[at];
        let guess = node.stage.estimate(&expected.of_inputs(node));
        // Inputs are left out: they tell nothing of cost, and of a plan most are not known yet.
        let manifest = self.manifest(at, &Inputs::new());
        let nearest = experience.nearest(node, &manifest);
        match nearest.filter(|(known, _)| known.is_of_the_size(&guess)) {
            Some((known, changes)) => known.cost(node, &changes, &guess),
            None => Cost {
                seconds: guess.seconds,
                memory: guess.memory,
                basis: Basis::Guess,
            },
        }
    }
}

impl Known {
    /// Whether a stage that is estimated so may take as much as this result did.
    fn is_of_the_size(&self, guess: &Estimate) -> bool {
        let far = |memory: u64| guess.memory > FAR.saturating_mul(memory);
        self.memory.is_none_or(|memory| !far(memory))
    }

    fn cost(&self, node: &Node, changes: &[Change], guess: &Estimate) -> Cost {
        let stage = self.stage.clone();
        let name = |change: &Change| change.path.trim_start_matches(PARAMETERS).to_owned();
        Cost {
            seconds: self.seconds * pace(node, changes),
            // Results of systems that do not tell, and those of earlier versions, have no such
            // figure.
            memory: self.memory.unwrap_or(guess.memory),
            basis: match changes.is_empty() {
                true => Basis::Result { stage },
                false => Basis::Like {
                    stage,
                    but: changes.iter().map(name).collect(),
                },
            },
        }
    }
}

/// How many times the steps of before there are now.
fn pace(node: &Node, changes: &[Change]) -> f64 {
    let steps = match node.stage.extension() {
        Extension::None => return 1.0,
        Extension::Possible(steps) | Extension::Impossible(steps, _) => {
            format!("{PARAMETERS}{steps}")
        }
    };
    let change = changes.iter().find(|change| change.path == steps);
    let number = |text: &Option<String>| text.as_ref()?.parse::<f64>().ok().filter(|n| *n > 0.0);
    // Parameters that have no number, or none before, say nothing of the pace.
    let ratio = change.and_then(|change| Some(number(&change.now)? / number(&change.before)?));
    ratio.unwrap_or(1.0)
}
