//! What a run would do: which stages have their results, which must be computed, and why. Changes
//! nothing.

mod cost;
mod forecast;
pub mod inputs;
pub mod sizes;
mod sources;

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use stages::Source;

pub use self::cost::{Basis, Cost, Experience};
pub use self::forecast::Forecast;
pub use self::inputs::Inputs;
pub use self::sizes::Expected;
pub use self::sources::{SourceError, sources};

use crate::pipeline::graph::{Graph, Node};
use crate::remote::Remote;
use crate::runner::explain::{Change, History, Reason, diff};
use crate::runner::key::Recipe;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::manifest::Manifest;
use crate::store::record::Record;
use crate::store::results::Lookup;

/// Everything that keys and decisions depend on.
pub struct Context<'a> {
    /// The stages.
    pub graph: &'a Graph,
    pub store: &'a Store,
    /// A store that others share, if there is one.
    pub remote: Option<&'a Remote>,
    /// The kind of device to compute on.
    pub device: &'a str,
    /// What the device of a result is called that was begun on `device` and finished on the CPU;
    /// `None` unless the user accepts such results: `--fallback cpu`.
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
    /// What each stage reads beside its inputs: [`sources()`].
    pub sources: &'a [Vec<Source>],
}

/// A stage whose inputs are all known.
pub struct Assessment {
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

impl Context<'_> {
    fn recipe<'r>(&'r self, at: usize, inputs: &'r Inputs) -> Recipe<'r> {
        let node = &self.graph.nodes[at];
        Recipe {
            node,
            inputs,
            sources: &self.sources[at],
            device: self.device,
            salt: self.salt,
        }
    }

    /// The recipe of what was begun on a GPU and went on on the CPU, where such results count.
    fn fallen<'r>(&'r self, at: usize, inputs: &'r Inputs) -> Option<Recipe<'r>> {
        let device = self
            .fallback
            .filter(|_| self.graph.nodes[at].stage.uses_device())?;
        Some(Recipe {
            device,
            ..self.recipe(at, inputs)
        })
    }

    /// The manifest of that.
    pub fn fallen_manifest(&self, at: usize, inputs: &Inputs) -> Option<Manifest> {
        Some(self.fallen(at, inputs)?.manifest())
    }

    /// What there is of a stage, and under which key: its own, or where that has nothing, that of a
    /// result which went on on the CPU.
    fn find(&self, at: usize, inputs: &Inputs) -> Result<(Digest, Lookup), StoreError> {
        let key = self.recipe(at, inputs).key();
        let found = self.store.results.lookup(&key)?;
        // The stage's own key goes first: a result that one device has computed is preferred to one
        // that two have.
        if let (Lookup::Absent, Some(fallen)) = (&found, self.fallen(at, inputs)) {
            let key = fallen.key();
            if let Lookup::Sound(record) = self.store.results.lookup(&key)? {
                return Ok((key, Lookup::Sound(record)));
            }
        }
        Ok((key, found))
    }

    /// Looks for the result of a stage, given the digests of all its inputs.
    pub fn assess(&self, at: usize, inputs: Inputs) -> Result<Assessment, StoreError> {
        let (key, found) = self.find(at, &inputs)?;
        let verdict = match found {
            // First of all: a forced stage runs whatever was found, damage included.
            _ if self.forced.contains(&at) => Err(Reason::Forced),
            Lookup::Sound(record) => Ok(record),
            Lookup::Broken(breakage) => Err(Reason::Broken(breakage)),
            Lookup::Absent => {
                let manifest = self.manifest(at, &inputs);
                Err(self
                    .reason(at, &manifest, &BTreeSet::new())?
                    // Nothing tells it from an earlier run, and yet there is no result: it was
                    // lost.
                    .unwrap_or(Reason::Lost))
            }
        };
        Ok(Assessment {
            key,
            inputs,
            verdict,
            is_remote: false,
        })
    }

    /// The same, with a result that can be fetched counted as there.
    fn with_remote(&self, assessment: Assessment) -> Assessment {
        match (&assessment.verdict, self.remote) {
            (Err(reason), Some(remote)) if *reason != Reason::Forced => {
                match remote.peek(&assessment.key) {
                    Some(record) => Assessment {
                        verdict: Ok(record),
                        is_remote: true,
                        ..assessment
                    },
                    None => assessment,
                }
            }
            _ => assessment,
        }
    }

    /// The stages whose results are all there without any being computed or fetched, each after
    /// those that it reads.
    pub fn cached(&self) -> Result<Vec<Found>, StoreError> {
        let mut cached = Vec::<Found>::new();
        let mut places = vec![None; self.graph.nodes.len()];
        // In the graph's order, so that a stage comes after those that it reads.
        for &at in &self.needed {
            let node = &self.graph.nodes[at];
            let result = |from: usize| match places[from] {
                Some(place) => Some(&cached.get::<usize>(place)?.record),
                None => self.given.get(&from),
            };
            let inputs = inputs::digests(node, result);
            // Without the digest of every input there is no key. The scheduler looks again once the
            // others have run.
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
        let fallen = self
            .fallen(at, inputs)
            .filter(|fallen| fallen.key() == *key);
        fallen.map_or_else(|| self.manifest(at, inputs), |fallen| fallen.manifest())
    }

    /// What tells a stage from its nearest past; `None` if nothing does.
    fn reason(
        &self,
        at: usize,
        manifest: &Manifest,
        unknown: &BTreeSet<&str>,
    ) -> Result<Option<Reason>, StoreError> {
        let node = &self.graph.nodes[at];
        // Of several earlier runs the one that differs least: the user has most likely changed that
        // one.
        let Some(past) = self.history.nearest(&node.name, manifest, unknown)? else {
            return Ok(Some(Reason::New));
        };
        let mut changes = diff(&past.manifest, manifest, unknown);
        self.name_origins(node, &mut changes);
        Ok((!changes.is_empty()).then_some(Reason::Changed(changes)))
    }

    /// Says of changed inputs which stages they come from.
    pub fn name_origins(&self, node: &Node, changes: &mut [Change]) {
        for change in changes {
            let wire = change
                .input()
                .and_then(|input| node.wires.iter().find(|wire| wire.input == input));
            change.from = wire.map(|wire| self.graph.nodes[wire.from].name.clone());
        }
    }
}
