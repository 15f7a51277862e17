//! From options to a checked pipeline, its store and its context. Writes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use compute::Device;
use stages::Source;

use super::device;
use super::error::Error;
use super::options::{Changes, Choice};
use crate::pipeline::graph::Graph;
use crate::pipeline::problem;
use crate::pipeline::set::Override;
use crate::remote::Remote;
use crate::runner::explain::History;
use crate::runner::plan::{self, Context};
use crate::store::Store;

/// A pipeline about to be planned or run.
pub struct Session {
    /// Its stages.
    pub graph: Graph,
    /// Where to compute.
    pub device: Device,
    /// What results are called that were begun on the device and went on on the CPU, if such count.
    fallback: Option<String>,
    salt: Option<String>,
    forced: BTreeSet<usize>,
    needed: BTreeSet<usize>,
    sources: Vec<Vec<Source>>,
    remote: Option<Remote>,
    /// The store, for reading: what was found in it and about files elsewhere.
    store: Store,
}

impl Session {
    /// Reads and checks everything that the options name.
    pub fn new(pipeline: &Path, changes: &Changes, choice: &Choice) -> Result<Self, Error> {
        Self::on(device::open(&changes.device)?, pipeline, changes, choice)
    }

    /// The same, on a device that was opened already.
    pub fn on(
        device: Device,
        pipeline: &Path,
        changes: &Changes,
        choice: &Choice,
    ) -> Result<Self, Error> {
        // Read first: a mistake in an option needs no file to be found.
        let overrides = changes
            .set
            .iter()
            .map(|set| Override::read(set))
            .collect::<Result<Vec<_>, _>>()?;
        let source = problem::SourceText::read(pipeline).map_err(|error| Error::Unreadable {
            path: pipeline.to_owned(),
            error,
        })?;
        let mut store = Store::open(&changes.folders.store)?;
        // Before anything is looked up: what is found must still be there when it is used.
        store.share_if_there();
        let files = crate::pipeline::with_bases(source)?;
        let graph = load(&files, &overrides, &store)?;
        let forced = find(&graph, &choice.force)?;
        let needed = graph.needed(&wanted(&graph, choice)?);
        let sources = plan::sources(&graph, &needed, &store)?;
        let remote = changes.remote.as_deref().map(Remote::open).transpose()?;
        let salt = changes.salt.clone();
        // On a CPU nothing can fall back to it, and results keep their own keys.
        let fallback = changes.fallback.as_ref().filter(|_| device.is_gpu());
        let fallback = fallback.map(|fallback| format!("{}, then {fallback}", device.kind()));
        Ok(Self {
            graph,
            device,
            fallback,
            salt,
            forced,
            needed,
            sources,
            remote,
            store,
        })
    }

    /// The context for planning and running.
    pub fn context<'s>(&'s self, store: &'s Store) -> Context<'s> {
        // What was looked up while the pipeline was read need not be looked up again.
        store.take_findings(&self.store);
        Context {
            graph: &self.graph,
            store,
            remote: self.remote.as_ref(),
            device: self.device.kind(),
            fallback: self.fallback.as_deref(),
            salt: self.salt.as_deref(),
            forced: self.forced.clone(),
            needed: self.needed.clone(),
            given: BTreeMap::new(),
            history: History::new(store, &self.graph.pipeline),
            sources: &self.sources,
        }
    }

    /// All files that the stages which are needed read beside their inputs; `None` where that
    /// cannot be said of one.
    pub fn source_files(&self, context: &Context) -> Option<BTreeSet<PathBuf>> {
        let stages = context.needed.iter().map(|&at| &self.graph.nodes[at].stage);
        let mut places = stages.filter(|stage| !stage.locations().is_empty());
        places.try_fold(BTreeSet::new(), |mut files, stage| {
            files.extend(stage.source_files()?);
            Some(files)
        })
    }

    /// The one stage of this name, even if the options left it out.
    pub fn stage(&self, name: &str) -> Result<usize, Error> {
        let found = self.graph.find(name)?;
        // A name can be that of a stage and the beginning of others, as `fit` of its shards
        // `fit.1`: the exact one is meant.
        let is_its_name = |at: usize| self.graph.nodes[at].names().any(|other| other == name);
        let exact = found.iter().find(|at| is_its_name(**at));
        match (exact, found.len(), found.first()) {
            (Some(&at), ..) | (None, 1, Some(&at)) => Ok(at),
            _ => {
                let names: Vec<&str> = found
                    .iter()
                    .map(|&at| self.graph.nodes[at].name.as_str())
                    .collect();
                Err(Error::usage(
                    format!("`{name}` is more than one stage"),
                    format!("name one of {}", names.join(", ")),
                ))
            }
        }
    }
}

/// A pipeline's stages, and meanwhile, on other threads, the results that the store's index
/// remembers: as many as could be needed.
fn load(
    files: &[problem::SourceText],
    overrides: &[Override],
    store: &Store,
) -> Result<Graph, problem::Problem> {
    let enough = AtomicBool::new(false);
    rayon::in_place_scope(|scope| {
        scope.spawn(|_| store.results.known.look_ahead(&enough));
        let graph = crate::pipeline::load(files, overrides);
        let stages = graph.as_ref().map_or(0, |graph| graph.nodes.len());
        // A store can remember many pipelines. Where it has far more than this one needs, looking
        // ahead is no gain.
        enough.store(store.results.known.are_many(stages), Ordering::Relaxed);
        graph
    })
}

/// The stages that are asked for: all, those of some names, those of some arms, or those of some
/// names in some arms.
fn wanted(graph: &Graph, choice: &Choice) -> Result<BTreeSet<usize>, Error> {
    let mut wanted: BTreeSet<usize> = if choice.target.is_empty() {
        (0..graph.nodes.len()).collect()
    } else {
        find(graph, &choice.target)?
    };
    if !choice.arm.is_empty() {
        let mut of_arms = BTreeSet::new();
        for arm in &choice.arm {
            of_arms.extend(graph.of_arm(arm)?);
        }
        wanted.retain(|at| of_arms.contains(at));
    }
    Ok(wanted)
}

fn find(graph: &Graph, names: &[String]) -> Result<BTreeSet<usize>, Error> {
    let mut all = BTreeSet::new();
    for name in names {
        all.extend(graph.find(name)?);
    }
    Ok(all)
}
