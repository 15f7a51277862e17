//! Which stage of a run is in which state. Decides which are ready; starts none.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use stages::Estimate;

use super::budget::Budget;
use crate::explain::Reason;
use crate::key::Manifest;
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
    /// The stages that failed, and why.
    pub failures: Vec<(usize, Failure)>,
    /// Whether the run was stopped before its end.
    pub interrupted: bool,
}

/// A stage that must run, and waits for room.
pub struct Queued {
    /// Its key.
    pub key: Digest,
    /// What is in the key.
    pub manifest: Manifest,
    /// Why it must run.
    pub reason: Reason,
    /// What it will take.
    pub estimate: Estimate,
    /// The key under which it was begun on a GPU that failed, if it goes on on the CPU.
    pub begun_as: Option<Digest>,
}

/// The one account of which stage is in which state. A stage is in exactly one of `waiting`,
/// `ready`, `queued`, `elsewhere`, `running` and `outcome.stages`.
pub struct Board<'p> {
    graph: &'p Graph,
    /// Not all inputs are there: how many are missing.
    waiting: BTreeMap<usize, usize>,
    /// All inputs are there.
    ready: BTreeSet<usize>,
    /// It has no result, and there was no room for it yet.
    queued: BTreeMap<usize, Queued>,
    /// Another process computes it.
    elsewhere: BTreeSet<usize>,
    /// The user knows that another process computes it.
    told: BTreeSet<usize>,
    /// It runs.
    running: BTreeMap<usize, Queued>,
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
        let mut waiting = BTreeMap::new();
        let mut ready = BTreeSet::new();
        let mut readers = vec![Vec::new(); nodes.len()];
        for &at in &context.needed {
            nodes[at]
                .wires
                .iter()
                .for_each(|wire| readers[wire.from].push(at));
            match nodes[at]
                .wires
                .iter()
                .filter(|wire| !context.given.contains_key(&wire.from))
                .count()
            {
                0 => drop(ready.insert(at)),
                missing => drop(waiting.insert(at, missing)),
            }
        }
        Self {
            graph: context.graph,
            waiting,
            ready,
            queued: BTreeMap::new(),
            elsewhere: BTreeSet::new(),
            told: BTreeSet::new(),
            running: BTreeMap::new(),
            readers,
            outcome: Outcome::default(),
            progress,
        }
    }

    /// The next stage whose inputs are all there.
    pub fn next(&mut self) -> Option<usize> {
        self.ready.pop_first()
    }

    /// A stage has no result.
    pub fn queue(&mut self, at: usize, stage: Queued) {
        self.queued.insert(at, stage);
    }

    /// The first stage that there is room for.
    pub fn admit(&mut self, budget: &Budget) -> Option<(usize, Queued)> {
        let running = self.running.values().map(|stage| &stage.estimate);
        let fits = |(_, stage): &(&usize, &Queued)| budget.admits(running.clone(), &stage.estimate);
        let at = *self.queued.iter().find(fits)?.0;
        self.queued.remove_entry(&at)
    }

    /// Whether no stage of this process runs, and if `patient`, none of another that we wait for.
    pub fn is_idle(&self, patient: bool) -> bool {
        self.running.is_empty() && (self.elsewhere.is_empty() || !patient)
    }

    /// A stage begins; with its first step, where it might have gone on from a result, for a reason
    /// that is told.
    pub fn begin(&mut self, at: usize, stage: Queued, obstacle: Option<&str>) {
        let reason = match obstacle {
            Some(why) => format!("{}; from the first step, since {why}", stage.reason),
            None => stage.reason.to_string(),
        };
        let name = &self.graph.nodes[at].name;
        self.progress.event(&Event::Started {
            stage: name,
            key: stage.key,
            reason: &reason,
        });
        self.running.insert(at, stage);
    }

    /// A stage of this process has ended.
    pub fn end(&mut self, at: usize) -> Option<Queued> {
        self.running.remove(&at)
    }

    /// Another process computes a stage.
    pub fn wait(&mut self, at: usize, holder: &Holder) {
        self.elsewhere.insert(at);
        if self.told.insert(at) {
            self.progress.event(&Event::Waiting {
                stage: &self.graph.nodes[at].name,
                holder,
            });
        }
    }

    /// The results of these stages are there already.
    pub fn adopt(&mut self, found: Vec<(usize, Record)>) {
        if found.is_empty() {
            return;
        }
        let name =
            |(at, record): &(usize, Record)| (self.graph.nodes[*at].name.as_str(), record.key);
        self.progress.event(&Event::Cached {
            results: &found.iter().map(name).collect::<Vec<_>>(),
        });
        for (at, record) in found {
            self.remark(at, &record);
            self.ready.remove(&at);
            self.done(at, StageRun::cached(record.key), record);
        }
    }

    /// Says again what whoever uses a result should know, since the stage itself does not run.
    pub fn remark(&mut self, at: usize, record: &Record) {
        let stage = &self.graph.nodes[at].name;
        for text in &record.remarks {
            self.progress.event(&Event::Warning { stage, text });
        }
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

    /// The arms that have no result where this stage has none.
    pub fn arms_lost(&self, failed: usize) -> Vec<&'p str> {
        self.graph.nodes[failed].arms().into_iter().collect()
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
            let stage = nodes[at].name.as_str();
            let by = nodes[failed].name.as_str();
            self.progress.event(&Event::Blocked { stage, by });
            self.outcome.stages.insert(
                at,
                StageRun {
                    end: End::Stopped,
                    key: None,
                    reason: None,
                    seconds: 0.0,
                },
            );
        }
    }

    /// Nothing happened for a while: another process may have finished what we wait for.
    pub fn tick(&mut self) {
        self.ready.append(&mut self.elsewhere);
        self.progress.event(&Event::Tick);
    }

    /// No stage runs any more, and none will.
    pub fn close(mut self, interrupted: bool) -> Outcome {
        let left = self
            .waiting
            .keys()
            .chain(&self.ready)
            .chain(self.queued.keys())
            .chain(&self.elsewhere);
        for &at in left {
            self.outcome.stages.insert(
                at,
                StageRun {
                    end: End::Stopped,
                    key: None,
                    reason: None,
                    seconds: 0.0,
                },
            );
        }
        self.outcome.interrupted = interrupted
            && self
                .outcome
                .stages
                .values()
                .any(|stage| stage.end == End::Stopped);
        self.outcome
    }
}
