//! What a run would do: which stages have their results, which must be computed, and why. Changes nothing.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use stages::{Source, StageError};

use crate::explain::{Change, History, Reason, diff};
use crate::key::{Manifest, Recipe};
use crate::pipeline::graph::{Graph, Node, Wire};
use crate::remote::Remote;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::result::{Lookup, Record};

/// Everything that keys and decisions depend on.
pub struct Context<'a> {
    /// The stages.
    pub graph: &'a Graph,
    /// The store.
    pub store: &'a Store,
    /// A store that others share, if there is one.
    pub remote: Option<&'a Remote>,
    /// The kind of device to compute on.
    pub device: &'a str,
    /// The kind that results have which were begun on that and went on on the CPU, where such count: `--fallback cpu`.
    pub fallback: Option<&'a str>,
    /// The user's word in all keys.
    pub salt: Option<&'a str>,
    /// Stages to compute whatever the store has.
    pub forced: BTreeSet<usize>,
    /// The stages that are wanted, and all that they need.
    pub needed: BTreeSet<usize>,
    /// Results of stages outside `needed` that these read.
    pub given: BTreeMap<usize, Record>,
    /// Earlier runs.
    pub history: History<'a>,
    /// What each stage reads beside its inputs: [`sources`].
    pub sources: &'a [Vec<Source>],
}

/// A stage whose inputs are all known.
pub struct Assessment {
    /// Its key.
    pub key: Digest,
    /// The digests of its inputs.
    pub inputs: Inputs,
    /// Its result, or why it must be computed.
    pub verdict: Result<Record, Reason>,
    /// Whether its result has yet to be fetched from the remote.
    pub is_remote: bool,
}

/// A stage whose result is there.
pub struct Found {
    /// The stage.
    pub at: usize,
    /// The digests of its inputs.
    pub inputs: Inputs,
    /// Its result.
    pub record: Record,
}

/// What will become of a stage.
pub enum Forecast {
    /// Its result is there.
    Cached(Box<Assessment>),
    /// It will be computed. Where its inputs are all known, so is its key.
    Run(Reason, Option<Box<Assessment>>),
    /// It will be computed unless these stages, which will be, give the results that they gave before.
    Unless(Vec<String>),
}

impl Forecast {
    /// The key and what is in it, where all inputs are known.
    pub fn assessment(&self) -> Option<&Assessment> {
        match self {
            Self::Cached(assessment) | Self::Run(_, Some(assessment)) => Some(assessment),
            _ => None,
        }
    }

    /// Whether the result is there.
    pub fn is_cached(&self) -> bool {
        matches!(self, Self::Cached(_))
    }

    /// The result, if it is there, here or in the remote.
    pub fn record(&self) -> Option<&Record> {
        match self {
            Self::Cached(assessment) => assessment.verdict.as_ref().ok(),
            _ => None,
        }
    }

    /// The same, to keep.
    pub fn into_record(self) -> Option<Record> {
        match self {
            Self::Cached(assessment) => assessment.verdict.ok(),
            _ => None,
        }
    }
}

/// The digests of a stage's inputs, by input name.
pub type Inputs = BTreeMap<&'static str, Digest>;

/// A stage that reads something beside its inputs which is not there, or not as it should be.
#[derive(Debug, thiserror::Error)]
#[error("stage `{stage}`: {error}")]
pub struct SourceError {
    /// The stage.
    pub stage: String,
    /// What is wrong.
    pub error: StageError,
}

impl Context<'_> {
    fn recipe<'r>(&'r self, at: usize, inputs: &'r Inputs) -> Recipe<'r> {
        let node = &self.graph.nodes[at];
        Recipe { node, inputs, sources: &self.sources[at], device: self.device, salt: self.salt }
    }

    /// The recipe of what was begun on a GPU and went on on the CPU, where such results count.
    fn fallen<'r>(&'r self, at: usize, inputs: &'r Inputs) -> Option<Recipe<'r>> {
        let device = self.fallback.filter(|_| self.graph.nodes[at].stage.uses_device())?;
        Some(Recipe { device, ..self.recipe(at, inputs) })
    }

    /// The manifest of that.
    pub fn fallen_manifest(&self, at: usize, inputs: &Inputs) -> Option<Manifest> {
        Some(self.fallen(at, inputs)?.manifest())
    }

    /// What there is of a stage, and under which key: its own, or where that has nothing, that of a result which went on on
    /// the CPU.
    fn find(&self, at: usize, inputs: &Inputs) -> Result<(Digest, Lookup), StoreError> {
        let key = self.recipe(at, inputs).key();
        let found = self.store.lookup(&key)?;
        if let (Lookup::Absent, Some(fallen)) = (&found, self.fallen(at, inputs)) {
            let key = fallen.key();
            if let Lookup::Sound(record) = self.store.lookup(&key)? {
                return Ok((key, Lookup::Sound(record)));
            }
        }
        Ok((key, found))
    }

    /// Looks for the result of a stage, given the digests of all its inputs.
    pub fn assess(&self, at: usize, inputs: Inputs) -> Result<Assessment, StoreError> {
        let (key, found) = self.find(at, &inputs)?;
        let verdict = match found {
            _ if self.forced.contains(&at) => Err(Reason::Forced),
            Lookup::Sound(record) => Ok(record),
            Lookup::Broken(breakage) => Err(Reason::Broken(breakage)),
            Lookup::Absent => {
                let manifest = self.manifest(at, &inputs);
                Err(self.reason(at, &manifest, &BTreeSet::new())?.unwrap_or(Reason::Lost))
            }
        };
        Ok(Assessment { key, inputs, verdict, is_remote: false })
    }

    /// The same, with a result that can be fetched counted as there.
    fn with_remote(&self, assessment: Assessment) -> Assessment {
        match (&assessment.verdict, self.remote) {
            (Err(reason), Some(remote)) if *reason != Reason::Forced => match remote.peek(&assessment.key) {
                Some(record) => Assessment { verdict: Ok(record), is_remote: true, ..assessment },
                None => assessment,
            },
            _ => assessment,
        }
    }

    /// The stages whose results are all there without any being computed or fetched, each after those that it reads.
    pub fn cached(&self) -> Result<Vec<Found>, StoreError> {
        let (mut cached, mut places) = (Vec::<Found>::new(), vec![None; self.graph.nodes.len()]);
        for &at in &self.needed {
            let node = &self.graph.nodes[at];
            let result = |from: usize| match places[from] {
                Some(place) => Some(&cached.get::<usize>(place)?.record),
                None => self.given.get(&from),
            };
            let digest = |wire: &Wire| Some((wire.input, result(wire.from)?.outputs.get(wire.output)?.digest));
            let inputs: Inputs = node.wires.iter().filter_map(digest).collect();
            if inputs.len() < node.wires.len() || self.forced.contains(&at) {
                continue;
            }
            if let (_, Lookup::Sound(record)) = self.find(at, &inputs)? {
                places[at] = Some(cached.len());
                cached.push(Found { at, inputs, record });
            }
        }
        Ok(cached)
    }

    /// What is in the key of a stage with these inputs.
    pub fn manifest(&self, at: usize, inputs: &Inputs) -> Manifest {
        self.recipe(at, inputs).manifest()
    }

    /// What is in one of the keys that a stage with these inputs can have.
    pub fn manifest_of(&self, at: usize, inputs: &Inputs, key: &Digest) -> Manifest {
        let fallen = self.fallen(at, inputs).filter(|fallen| fallen.key() == *key);
        fallen.map_or_else(|| self.manifest(at, inputs), |fallen| fallen.manifest())
    }

    /// What tells a stage from its nearest past; `None` if nothing does.
    fn reason(&self, at: usize, manifest: &Manifest, unknown: &BTreeSet<&str>) -> Result<Option<Reason>, StoreError> {
        let node = &self.graph.nodes[at];
        let Some(past) = self.history.nearest(&node.name, manifest, unknown)? else { return Ok(Some(Reason::New)) };
        let mut changes = diff(&past.manifest, manifest, unknown);
        self.name_origins(node, &mut changes);
        Ok((!changes.is_empty()).then_some(Reason::Changed(changes)))
    }

    /// Says of changed inputs which stages they come from.
    pub fn name_origins(&self, node: &Node, changes: &mut [Change]) {
        for change in changes {
            let wire = change.input().and_then(|input| node.wires.iter().find(|wire| wire.input == input));
            change.from = wire.map(|wire| self.graph.nodes[wire.from].name.clone());
        }
    }

    /// What is in the keys of all stages that are needed: of those whose inputs are not all known, what is known of it.
    pub fn manifests(&self, forecasts: &BTreeMap<usize, Forecast>) -> Vec<(usize, Manifest)> {
        let manifest = |&at: &usize| match forecasts.get(&at).and_then(Forecast::assessment) {
            Some(known) => (at, self.manifest_of(at, &known.inputs, &known.key)),
            None => (at, self.manifest(at, &known_inputs(&self.graph.nodes[at], forecasts).0)),
        };
        self.needed.iter().map(manifest).collect()
    }

    /// Foretells what becomes of every stage that is needed.
    pub fn forecast(&self) -> Result<BTreeMap<usize, Forecast>, StoreError> {
        let mut forecasts = BTreeMap::new();
        for &at in &self.needed {
            let forecast = self.forecast_one(at, &forecasts)?;
            forecasts.insert(at, forecast);
        }
        Ok(forecasts)
    }

    fn forecast_one(&self, at: usize, upstream: &BTreeMap<usize, Forecast>) -> Result<Forecast, StoreError> {
        let node = &self.graph.nodes[at];
        let (inputs, unknown) = known_inputs(node, upstream);
        if unknown.is_empty() {
            let assessment = self.with_remote(self.assess(at, inputs)?);
            return Ok(match &assessment.verdict {
                Ok(_) => Forecast::Cached(Box::new(assessment)),
                Err(reason) => Forecast::Run(reason.clone(), Some(Box::new(assessment))),
            });
        }
        if self.forced.contains(&at) {
            return Ok(Forecast::Run(Reason::Forced, None));
        }
        let manifest = self.manifest(at, &inputs);
        match self.reason(at, &manifest, &unknown.keys().copied().collect())? {
            Some(reason) => Ok(Forecast::Run(reason, None)),
            None => {
                let waits: BTreeSet<usize> = unknown.into_values().collect();
                Ok(Forecast::Unless(waits.iter().map(|&from| self.graph.nodes[from].name.clone()).collect()))
            }
        }
    }
}

/// The digests of the inputs that are known already, and the stages that the others come from.
fn known_inputs<'n>(node: &'n Node, upstream: &BTreeMap<usize, Forecast>) -> (Inputs, BTreeMap<&'n str, usize>) {
    let (mut known, mut unknown) = (Inputs::new(), BTreeMap::new());
    for wire in &node.wires {
        let record = match upstream.get(&wire.from) {
            Some(Forecast::Cached(assessment)) => assessment.verdict.as_ref().ok(),
            _ => None,
        };
        match record.and_then(|record| record.outputs.get(wire.output)) {
            Some(output) => drop(known.insert(wire.input, output.digest)),
            None => drop(unknown.insert(wire.input, wire.from)),
        }
    }
    (known, unknown)
}

/// What the stages that are needed read beside their inputs; stages of one kind with the same parameters read the same. What a store
/// remembers of files that have not changed is not read again.
pub fn sources(graph: &Graph, needed: &BTreeSet<usize>, store: &Store) -> Result<Vec<Vec<Source>>, SourceError> {
    let mut known: BTreeMap<String, Vec<Source>> = BTreeMap::new();
    let mut all = vec![Vec::new(); graph.nodes.len()];
    for &at in needed {
        let node = &graph.nodes[at];
        // What names no place reads nothing; most stages are such, and there may be thousands.
        if node.stage.locations().is_empty() {
            continue;
        }
        let what = format!("{} {} {}", node.stage.kind(), node.stage.version(), node.params);
        if !known.contains_key(&what) {
            let ask = || node.stage.sources().map_err(|error| SourceError { stage: node.name.clone(), error });
            let read = match node.stage.source_files() {
                Some(files) if !files.is_empty() => store.while_unchanged(&what, &files, ask)?,
                _ => ask()?,
            };
            known.insert(what.clone(), read);
        }
        all[at].clone_from(&known[&what]);
    }
    Ok(all)
}
