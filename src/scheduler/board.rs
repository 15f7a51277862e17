//! Which stage of a run is in which state. Decides which are ready; starts none.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;

use crate::explain::Reason;
use crate::pipeline::graph::Graph;
use crate::plan::Context;
use crate::progress::{Event, Progress};
use crate::store::holder::Holder;
use crate::store::result::Record;
use crate::store::runs::{End, StageRun};
use crate::task::Failure;

/// What became of a run.
#[derive(Debug, Default)]
pub struct Outcome {
    /// What became of each stage.
    pub stages: BTreeMap<usize, StageRun>,
    /// The results that there are.
    pub records: BTreeMap<usize, Record>,
    /// Why stages failed.
    pub failures: Vec<Failure>,
    /// Whether the run was stopped before its end.
    pub interrupted: bool,
}

/// The one account of which stage is in which state. A stage is in exactly one of `waiting`, `ready`, `elsewhere`, `running`
/// and `outcome.stages`.
pub struct Board<'p> {
    graph: &'p Graph,
    /// Not all inputs are there: how many are missing.
    waiting: BTreeMap<usize, usize>,
    /// All inputs are there.
    ready: BTreeSet<usize>,
    /// Another process computes it.
    elsewhere: BTreeSet<usize>,
    /// The user knows that another process computes it.
    told: BTreeSet<usize>,
    /// It runs: its key, and why.
    running: BTreeMap<usize, (Digest, Reason)>,
    /// Who reads each stage, once for every input.
    readers: Vec<Vec<usize>>,
    /// It is over.
    pub outcome: Outcome,
    /// Who is told what happens.
    pub progress: &'p mut dyn Progress,
}

impl<'p> Board<'p> {
    /// Before the first stage of a run.
    pub fn new(context: &Context<'p>, progress: &'p mut dyn Progress) -> Self {
        let nodes = &context.graph.nodes;
        let (mut waiting, mut ready, mut readers) = (BTreeMap::new(), BTreeSet::new(), vec![Vec::new(); nodes.len()]);
        for &at in &context.needed {
            nodes[at].wires.iter().for_each(|wire| readers[wire.from].push(at));
            match nodes[at].wires.iter().filter(|wire| !context.given.contains_key(&wire.from)).count() {
                0 => drop(ready.insert(at)),
                missing => drop(waiting.insert(at, missing)),
            }
        }
        let (elsewhere, told, running) = (BTreeSet::new(), BTreeSet::new(), BTreeMap::new());
        let (graph, outcome) = (context.graph, Outcome::default());
        Self { graph, waiting, ready, elsewhere, told, running, readers, outcome, progress }
    }

    /// The next stage whose inputs are all there, if not too many run.
    pub fn next(&mut self, most: usize) -> Option<usize> {
        if self.running.len() < most { self.ready.pop_first() } else { None }
    }

    /// Whether no stage of this process runs, and if `patient`, none of another that we wait for.
    pub fn is_idle(&self, patient: bool) -> bool {
        self.running.is_empty() && (self.elsewhere.is_empty() || !patient)
    }

    /// A stage begins.
    pub fn begin(&mut self, at: usize, key: Digest, reason: Reason) {
        let stage = &self.graph.nodes[at].name;
        self.progress.event(&Event::Started { stage, key, reason: &reason.to_string() });
        self.running.insert(at, (key, reason));
    }

    /// A stage of this process has ended: its key, and why it ran.
    pub fn end(&mut self, at: usize) -> Option<(Digest, Reason)> {
        self.running.remove(&at)
    }

    /// Another process computes a stage.
    pub fn wait(&mut self, at: usize, holder: &Holder) {
        self.elsewhere.insert(at);
        if self.told.insert(at) {
            self.progress.event(&Event::Waiting { stage: &self.graph.nodes[at].name, holder });
        }
    }

    /// A stage's result is there already.
    pub fn adopt(&mut self, at: usize, key: Digest, record: Record) {
        self.ready.remove(&at);
        self.progress.event(&Event::Cached { stage: &self.graph.nodes[at].name, key });
        self.done(at, StageRun { end: End::Cached, key: Some(key), reason: None, seconds: 0.0 }, record);
    }

    /// A stage has its result: those that read it may have become ready.
    pub fn done(&mut self, at: usize, run: StageRun, record: Record) {
        self.outcome.stages.insert(at, run);
        self.outcome.records.insert(at, record);
        for reader in &self.readers[at] {
            if let Some(missing) = self.waiting.get_mut(reader) {
                *missing -= 1;
                if *missing == 0 {
                    self.waiting.remove(reader);
                    self.ready.insert(*reader);
                }
            }
        }
    }

    /// A stage has failed: all that depend on it will not run.
    pub fn block(&mut self, failed: usize) {
        let nodes = &self.graph.nodes;
        let mut lost: Vec<usize> = self.readers[failed].clone();
        while let Some(at) = lost.pop() {
            if self.waiting.remove(&at).is_none() {
                continue;
            }
            lost.extend(&self.readers[at]);
            let (stage, by) = (nodes[at].name.as_str(), nodes[failed].name.as_str());
            self.progress.event(&Event::Blocked { stage, by });
            self.outcome.stages.insert(at, StageRun { end: End::Stopped, key: None, reason: None, seconds: 0.0 });
        }
    }

    /// Nothing happened for a while: another process may have finished what we wait for.
    pub fn tick(&mut self) {
        self.ready.append(&mut self.elsewhere);
        self.progress.event(&Event::Tick);
    }

    /// No stage runs any more, and none will.
    pub fn close(mut self, interrupted: bool) -> Outcome {
        let left = self.waiting.keys().chain(&self.ready).chain(&self.elsewhere);
        for &at in left {
            self.outcome.stages.insert(at, StageRun { end: End::Stopped, key: None, reason: None, seconds: 0.0 });
        }
        self.outcome.interrupted = interrupted && self.outcome.stages.values().any(|stage| stage.end == End::Stopped);
        self.outcome
    }
}
