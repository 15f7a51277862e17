//! Runs stages: each as soon as its inputs are there, several at once, every result committed as a
//! whole.
//!
//! One thread owns the state of all stages; each running stage has a thread of its own, which
//! computes in the one pool that all share. Knows stages only by the [`stages::Stage`] trait, and
//! printing only by the [`Progress`] trait.

mod board;
pub mod budget;
#[cfg(test)]
mod gpu_failures;
pub mod memory_limit;
#[cfg(test)]
mod properties;
mod start;
mod states;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use artifacts_schema::Digest;
use compute::Device;
use rayon::prelude::*;
use stages::Message;

use crate::runner::explain::Reason;
use crate::runner::plan::{Assessment, Context, Found, Inputs, inputs};
use crate::runner::task::Failure;
use crate::store::error::StoreError;
use crate::store::record::Record;
use crate::store::runs::{End, StageRun};
use crate::store::view::View;
use crate::terminal::progress::{Event, Progress};
use board::Board;
pub use board::Outcome;
use budget::Budget;
use states::Queued;

/// How often to look for a signal, and for what other processes have finished.
const TICK: Duration = Duration::from_millis(100);

/// What it takes to run stages.
pub struct Scheduler<'a> {
    /// The stages and their keys.
    pub context: &'a Context<'a>,
    /// The threads that stages share.
    pub pool: &'a rayon::ThreadPool,
    /// Where stages compute.
    pub device: &'a Device,
    /// Where people find results.
    pub view: &'a View,
    /// Set when the run is to stop.
    pub cancelled: &'a AtomicBool,
    /// How often stages keep checkpoints.
    pub checkpoint_every: Duration,
    /// What stages may take together.
    pub budget: Budget,
    /// Whether a stage that fails ends the run: otherwise all go on that do not depend on it.
    pub fail_fast: bool,
}

/// What a stage's thread says.
enum News {
    Said(usize, Message),
    Ended(usize, Box<Result<Record, Failure>>, f64),
}

impl Scheduler<'_> {
    /// Runs all stages that are needed but those that are `cached`. An error here is one of the
    /// store; a stage's is part of the outcome.
    pub fn run(
        &self,
        cached: Vec<Found>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome, StoreError> {
        let mut board = Board::new(self.context, progress);
        // Without a bound: a stage must not wait for the thread that prints what it says.
        let (sender, news) = mpsc::channel();
        std::thread::scope(|scope| {
            // The others must not go on for hours before anyone hears that the store cannot be
            // used.
            self.adopt(&mut board, cached)
                .and_then(|()| self.drive(&mut board, scope, &sender, &news))
                .inspect_err(|_| self.cancelled.store(true, Ordering::Relaxed))
        })?;
        Ok(board.close(self.stopped()))
    }

    fn drive<'s>(
        &'s self,
        board: &mut Board,
        scope: &'s Scope<'s, '_>,
        sender: &Sender<News>,
        news: &Receiver<News>,
    ) -> Result<(), StoreError> {
        // By the clock, not whenever nothing was heard: a stage that talks all the time must not
        // keep the others from being looked at.
        let mut ticked = Instant::now();
        loop {
            self.begin_all(board, scope, sender)?;
            // Whatever is queued begins once nothing else runs, since alone any stage may: idle
            // means that there is no more to do. A run that is being stopped waits for nobody else.
            if board.is_idle(!self.stopped()) {
                return Ok(());
            }
            if let Ok(news) = news.recv_timeout(TICK) {
                self.take(board, news)?;
            }
            if ticked.elapsed() >= TICK {
                board.tick();
                ticked = Instant::now();
            }
        }
    }

    /// Takes over, all at once, the results that are there already: with thousands of them, one by
    /// one would take long.
    fn adopt(&self, board: &mut Board, cached: Vec<Found>) -> Result<(), StoreError> {
        let store = self.context.store;
        let show = |found: &Found| self.show(found.at, &found.record);
        // Shown before they are told of: who reads of a result can open it.
        self.pool.install(|| cached.par_iter().try_for_each(show))?;
        // A manifest may be gone while its result is sound. It comes out in order, for the search
        // below.
        let lost = self.pool.install(|| {
            store
                .manifests
                .missing(cached.iter().map(|found| found.record.key))
        });
        for found in cached
            .iter()
            .filter(|found| lost.binary_search(&found.record.key).is_ok())
        {
            // Only explanations need it: where that cannot be done, nothing else fails.
            let key = &found.record.key;
            let _ = store
                .manifests
                .put(key, &self.context.manifest_of(found.at, &found.inputs, key));
        }
        board.adopt(
            cached
                .into_iter()
                .map(|found| (found.at, found.record))
                .collect(),
        );
        Ok(())
    }

    /// Shows a result under all names of its stage.
    fn show(&self, at: usize, record: &Record) -> Result<(), StoreError> {
        let names = self.context.graph.nodes[at].names();
        self.view.show_all(self.context.store, names, record)
    }

    fn stopped(&self) -> bool {
        // The flag guards no data, so that it need not be seen at once.
        self.cancelled.load(Ordering::Relaxed)
    }

    fn name(&self, at: usize) -> &str {
        &self.context.graph.nodes[at].name
    }

    /// Looks for the results of all stages that are ready, and begins those that have none while
    /// there is room for them.
    fn begin_all<'s>(
        &'s self,
        board: &mut Board,
        scope: &'s Scope<'s, '_>,
        sender: &Sender<News>,
    ) -> Result<(), StoreError> {
        while !self.stopped() {
            // What is known to run begins first, and computes while the results of the others are
            // looked up.
            if let Some((at, queued)) = board.admit(&self.budget) {
                self.begin(board, at, queued, scope, sender)?;
            } else if let Some(at) = board.next() {
                let inputs = self.inputs(at, &board.outcome.records);
                let Assessment {
                    key,
                    inputs,
                    verdict,
                    ..
                } = self.pool.install(|| self.context.assess(at, inputs))?;
                match verdict {
                    Ok(record) => self.reuse(board, at, record)?,
                    Err(reason) if self.fetch(board, at, key, &reason)? => {}
                    Err(reason) => {
                        let manifest = self.context.manifest(at, &inputs);
                        // All inputs are there by now, so that their sizes count.
                        let estimate = self.estimate(at, &board.outcome.records);
                        board.queue(
                            at,
                            Queued {
                                key,
                                manifest,
                                reason,
                                estimate,
                                begun_as: None,
                            },
                        );
                    }
                }
            } else {
                return Ok(());
            }
        }
        Ok(())
    }

    fn inputs(&self, at: usize, records: &BTreeMap<usize, Record>) -> Inputs {
        let node = &self.context.graph.nodes[at];
        inputs::digests(node, |from| self.result(from, records))
    }

    /// The result of a stage that others read: of this run, or given to it.
    fn result<'r>(&'r self, at: usize, records: &'r BTreeMap<usize, Record>) -> Option<&'r Record> {
        records.get(&at).or_else(|| self.context.given.get(&at))
    }

    fn reuse(&self, board: &mut Board, at: usize, record: Record) -> Result<(), StoreError> {
        self.show(at, &record)?;
        board.adopt(vec![(at, record)]);
        Ok(())
    }

    /// Whether the remote had a stage's result. Everything else waits meanwhile, which spares it
    /// from running into what is on its way.
    fn fetch(
        &self,
        board: &mut Board,
        at: usize,
        key: Digest,
        reason: &Reason,
    ) -> Result<bool, StoreError> {
        // Who forces a stage wants it computed here, not somebody else's result.
        let Some(remote) = self.context.remote.filter(|_| *reason != Reason::Forced) else {
            return Ok(false);
        };
        let fetched = remote.fetch(self.context.store, &key)?;
        self.tell(board);
        let Some((record, bytes)) = fetched else {
            return Ok(false);
        };
        board.progress.event(&Event::Fetched {
            stage: self.name(at),
            key,
            bytes,
        });
        board.remark(at, &record);
        self.show(at, &record)?;
        board.done(at, StageRun::cached(key), record);
        Ok(true)
    }

    /// Passes on what the remote has to say.
    fn tell(&self, board: &mut Board) {
        let notices = self
            .context
            .remote
            .iter()
            .flat_map(|remote| remote.notices());
        notices.for_each(|text| board.progress.event(&Event::Notice { text: &text }));
    }

    fn take(&self, board: &mut Board, news: News) -> Result<(), StoreError> {
        match news {
            News::Said(at, message) => board.progress.event(&Event::Said {
                stage: self.name(at),
                message: &message,
            }),
            News::Ended(at, result, seconds) => {
                self.end(board, at, *result, seconds)?;
                self.tell(board);
            }
        }
        Ok(())
    }

    fn end(
        &self,
        board: &mut Board,
        at: usize,
        result: Result<Record, Failure>,
        seconds: f64,
    ) -> Result<(), StoreError> {
        let Some(ended) = board.end(at) else {
            return Ok(());
        };
        let result = match result {
            Err(Failure::Device(fault)) => match self.fall_back(board, at, &ended, &fault) {
                // The stage has not ended: it goes back into the queue under its other key, and its
                // readers wait on.
                Some(queued) => {
                    board.queue(at, queued);
                    return Ok(());
                }
                None => Err(Failure::Device(fault)),
            },
            other => other,
        };
        let Queued { key, reason, .. } = ended;
        let run = |end| StageRun {
            end,
            key: Some(key),
            reason: Some(reason.to_string()),
            seconds,
        };
        let stage = self.name(at);
        match result {
            Ok(record) => {
                self.show(at, &record)?;
                board.progress.event(&Event::Finished {
                    stage,
                    seconds,
                    record: &record,
                });
                board.done(at, run(End::Ran), record);
            }
            // No failure: the other process computes the same, and its result is used.
            Err(Failure::Lost(holder)) => board.wait(at, &holder),
            Err(Failure::Stopped) => {
                board.progress.event(&Event::Stopped { stage });
                board.over(at, run(End::Stopped));
            }
            Err(failure) => {
                board.progress.event(&Event::Failed {
                    stage,
                    error: &failure.text(),
                    arms: &board.arms_lost(at),
                });
                board.over(at, run(End::Failed));
                board.outcome.failures.push((at, failure));
                // After the failure is told, so that people read of the cause before they read of
                // what it stops.
                board.block(at);
                if self.fail_fast {
                    // The same flag as for a signal: the stages that run keep checkpoints and stop.
                    self.cancelled.store(true, Ordering::Relaxed);
                }
            }
        }
        Ok(())
    }
}
