//! What will become of every stage of a run, before any runs. Knows what keys are made of only
//! through [`Context`].

use std::collections::{BTreeMap, BTreeSet};

use super::{Assessment, Context, Inputs, inputs};
use crate::pipeline::graph::Node;
use crate::runner::explain::Reason;
use crate::store::error::StoreError;
use crate::store::manifest::Manifest;
use crate::store::record::Record;

/// What will become of a stage.
pub enum Forecast {
    /// Its result is there.
    Cached(Box<Assessment>),
    /// It will be computed. Where its inputs are all known, so is its key.
    Run(Reason, Option<Box<Assessment>>),
    /// It will be computed, unless these stages, which are computed before it, come to the same
    /// results as they did.
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

impl Context<'_> {
    /// What is in the keys of all stages that are needed: of those whose inputs are not all known,
    /// what is known of it.
    pub fn manifests(&self, forecasts: &BTreeMap<usize, Forecast>) -> Vec<(usize, Manifest)> {
        let manifest = |&at: &usize| match forecasts.get(&at).and_then(Forecast::assessment) {
            Some(known) => (at, self.manifest_of(at, &known.inputs, &known.key)),
            None => (
                at,
                self.manifest(at, &known_inputs(&self.graph.nodes[at], forecasts).0),
            ),
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

    fn forecast_one(
        &self,
        at: usize,
        upstream: &BTreeMap<usize, Forecast>,
    ) -> Result<Forecast, StoreError> {
        let node = &self.graph.nodes[at];
        let (inputs, unknown) = known_inputs(node, upstream);
        if unknown.is_empty() {
            // Only here is the remote asked: of a stage without a key there is nothing to ask for.
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
        // If it differs by itself, it runs in any case. If only inputs are unknown, they may turn
        // out as before and spare it.
        match self.reason(at, &manifest, &unknown.keys().copied().collect())? {
            Some(reason) => Ok(Forecast::Run(reason, None)),
            None => {
                // A stage that several inputs come from is named once.
                let waits: BTreeSet<usize> = unknown.into_values().collect();
                Ok(Forecast::Unless(
                    waits
                        .iter()
                        .map(|&from| self.graph.nodes[from].name.clone())
                        .collect(),
                ))
            }
        }
    }
}

/// The digests of the inputs that are known already, and the stages that the others come from.
fn known_inputs<'n>(
    node: &'n Node,
    upstream: &BTreeMap<usize, Forecast>,
) -> (Inputs, BTreeMap<&'n str, usize>) {
    let known = inputs::digests(node, |from| upstream.get(&from)?.record());
    let wires = node.wires.iter();
    let unknown = wires.filter(|wire| !known.contains_key(&wire.input));
    let unknown = unknown
        .map(|wire| (wire.input.as_str(), wire.from))
        .collect();
    (known, unknown)
}
