//! Which stage of a run is in which state. Decides which are ready; starts none.

use std::collections::{BTreeMap, BTreeSet};

use super::budget::Budget;
use super::states::{Kind, Queued, State, States};
use crate::pipeline::graph::Graph;
use crate::runner::plan::Context;
use crate::runner::task::Failure;
use crate::store::leases::holder::Holder;
use crate::store::record::Record;
use crate::store::runs::{End, StageRun};
use crate::terminal::progress::{Event, Progress};

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

/// The one account of which stage is in which state.
pub struct Board<'p> {
    graph: &'p Graph,
    states: States,
    /// Who reads each stage, once for every input.
    readers: Vec<Vec<usize>>,
    /// The stages of which the user knows that another process computes them.
    told: BTreeSet<usize>,
    /// What the run has come to so far, but for `stages`, which [`Board::close`] fills in.
    pub outcome: Outcome,
    /// Who is told what happens.
    pub progress: &'p mut dyn Progress,
}

impl<'p> Board<'p> {
    /// Before the first stage of a run.
    pub fn new(context: &Context<'p>, progress: &'p mut dyn Progress) -> Self {
        let nodes = &context.graph.nodes;
        let mut states = States::new(nodes.len());
        let mut readers = vec![Vec::new(); nodes.len()];
        for &at in &context.needed {
            let inputs = nodes[at].wires.iter().map(|wire| wire.from);
            inputs.clone().for_each(|from| readers[from].push(at));
            // What is given has no end to wait for: those stages are no part of the run.
            let missing = inputs.filter(|from| !context.given.contains_key(from));
            states.set(at, waiting_for(missing.count()));
        }
        Self {
            graph: context.graph,
            states,
            readers,
            told: BTreeSet::new(),
            outcome: Outcome::default(),
            progress,
        }
    }

    /// Takes the next stage whose inputs are all there.
    pub fn next(&mut self) -> Option<usize> {
        // In the order of the pipeline, so that runs of one thread always go the same way.
        let at = self.states.all(Kind::Ready).next()?;
        self.states.set(at, State::Held);
        Some(at)
    }

    /// A stage has no result.
    pub fn queue(&mut self, at: usize, stage: Queued) {
        self.states.set(at, State::Queued(Box::new(stage)));
    }

    /// Takes the first stage that there is room for.
    pub fn admit(&mut self, budget: &Budget) -> Option<(usize, Queued)> {
        let at = self.first_that_fits(budget)?;
        self.take(at).map(|stage| (at, stage))
    }

    fn first_that_fits(&self, budget: &Budget) -> Option<usize> {
        let running = self.states.known(Kind::Running);
        let running = running.map(|(_, stage)| &stage.estimate);
        let mut queued = self.states.known(Kind::Queued);
        let fits = |stage: &Queued| budget.admits(running.clone(), &stage.estimate);
        // A small stage may overtake a large one. The large one gets its turn at the latest when
        // nothing else runs.
        queued.find(|(_, stage)| fits(stage)).map(|(at, _)| at)
    }

    /// Takes a stage out of its state, with what was known of it.
    fn take(&mut self, at: usize) -> Option<Queued> {
        match self.states.set(at, State::Held) {
            State::Queued(stage) | State::Running(stage) => Some(*stage),
            _ => None,
        }
    }

    /// Whether no stage of this process runs, and if `patient`, none of another that we wait for.
    pub fn is_idle(&self, patient: bool) -> bool {
        let runs = self.states.all(Kind::Running).next().is_some();
        let waits = patient && self.states.all(Kind::Elsewhere).next().is_some();
        !runs && !waits
    }

    /// A stage begins. `obstacle` says why it begins with its first step although a shorter run of
    /// it is there.
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
        self.states.set(at, State::Running(Box::new(stage)));
    }

    /// Takes a stage whose thread has ended.
    pub fn end(&mut self, at: usize) -> Option<Queued> {
        self.take(at)
    }

    /// Another process computes a stage.
    pub fn wait(&mut self, at: usize, holder: &Holder) {
        self.states.set(at, State::Elsewhere);
        // Once: a stage elsewhere is looked at again with every tick, and would be told of each
        // time.
        if self.told.insert(at) {
            self.progress.event(&Event::Waiting {
                stage: &self.graph.nodes[at].name,
                holder,
            });
        }
    }

    /// The results of these stages are there already.
    pub fn adopt(&mut self, found: Vec<(usize, Record)>) {
        // An event of no results would print an empty line.
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
        self.over(at, run);
        self.outcome.records.insert(at, record);
        for &reader in &self.readers[at] {
            // Readers that the run does not need, or that another failure has blocked, are left as
            // they are.
            if let State::Waiting { missing } = *self.states.get(reader) {
                self.states.set(reader, waiting_for(missing - 1));
            }
        }
    }

    /// Nothing more happens to a stage.
    pub fn over(&mut self, at: usize, run: StageRun) {
        self.states.set(at, State::Over(run));
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
            // A reader still waits for this stage, or was blocked by another failure: then it has
            // been told of, with all behind it.
            if !matches!(self.states.get(at), State::Waiting { .. }) {
                continue;
            }
            lost.extend(&self.readers[at]);
            let stage = nodes[at].name.as_str();
            let by = nodes[failed].name.as_str();
            self.progress.event(&Event::Blocked { stage, by });
            self.over(at, StageRun::stopped());
        }
    }

    /// Nothing happened for a while: another process may have finished what we wait for.
    pub fn tick(&mut self) {
        let elsewhere: Vec<usize> = self.states.all(Kind::Elsewhere).collect();
        for at in elsewhere {
            // Ready, not queued: its result is looked for first, and its lease is asked for only if
            // there is none.
            self.states.set(at, State::Ready);
        }
        self.progress.event(&Event::Tick);
    }

    /// No stage runs any more, and none will.
    pub fn close(self, interrupted: bool) -> Outcome {
        let stages = self.states.close(&StageRun::stopped());
        // A signal that came when all was done has interrupted nothing.
        let unfinished = stages.values().any(|stage| stage.end == End::Stopped);
        Outcome {
            stages,
            interrupted: interrupted && unfinished,
            ..self.outcome
        }
    }
}

/// The state of a stage that lacks so many of its inputs.
fn waiting_for(missing: usize) -> State {
    match missing {
        0 => State::Ready,
        missing => State::Waiting { missing },
    }
}
