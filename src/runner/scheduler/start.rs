//! The start of a stage: its lease, its inputs, its thread. Does not decide which stage is next.

use std::collections::BTreeMap;
use std::sync::mpsc::Sender;
use std::thread::Scope;
use std::time::Instant;

use artifacts_schema::Digest;
use compute::GpuError;
use stages::Estimate;

use super::board::Board;
use super::states::Queued;
use super::{News, Scheduler};
use crate::runner::explain::Reason;
use crate::runner::extension;
use crate::runner::plan::{inputs, sizes};
use crate::runner::task::{CPU, Task, device_of};
use crate::store::error::StoreError;
use crate::store::record::{Output, Record};
use crate::store::results::Lookup;
use crate::store::state;
use crate::store::work::Work;
use crate::terminal::progress::Event;

impl Scheduler<'_> {
    /// Begins a stage, unless another process has it.
    pub(super) fn begin<'s>(
        &'s self,
        board: &mut Board,
        at: usize,
        queued: Queued,
        scope: &'s Scope<'s, '_>,
        sender: &Sender<News>,
    ) -> Result<(), StoreError> {
        // The lease comes before everything else: only its holder may touch the key's folder, or
        // move a damaged result away.
        let Some(work) = self.claim(board, at, queued.key, &queued.reason)? else {
            return Ok(());
        };
        // The checkpoint of the GPU's key is copied before the stage looks for one of its own.
        queued
            .begun_as
            .iter()
            .for_each(|begun| work.take_over(begun));
        // Before the stage runs: whenever there is a result, there is a manifest that says of what.
        self.context
            .store
            .manifests
            .put(&queued.key, &queued.manifest)?;
        let task = self.task(at, &queued, work, &board.outcome.records)?;
        if let Some(text) = self.budget.complaint(&queued.estimate) {
            board.progress.event(&Event::Warning {
                stage: self.name(at),
                text: &text,
            });
        }
        let obstacle = extension::obstacle(task.node.stage.extension(), &queued.reason);
        board.begin(at, queued, obstacle);
        let sender = sender.clone();
        scope.spawn(move || self.work(at, task, &sender));
        Ok(())
    }

    /// What a stage will take, now that its inputs are there.
    pub(super) fn estimate(&self, at: usize, records: &BTreeMap<usize, Record>) -> Estimate {
        let node = &self.context.graph.nodes[at];
        let store = self.context.store;
        let sizes = sizes::of_results(store, node, |from| self.result(from, records));
        let estimate = node.stage.estimate(&sizes);
        Estimate {
            // A stage whose parameters keep it off the device must not wait for it.
            device: estimate.device && node.stage.uses_device(),
            ..estimate
        }
    }

    /// The private folder of a stage that must run, its damaged result out of the way. `None` if
    /// another process has the folder, or had it and has left a result by now.
    fn claim(
        &self,
        board: &mut Board,
        at: usize,
        key: Digest,
        reason: &Reason,
    ) -> Result<Option<Work<'_>>, StoreError> {
        let store = self.context.store;
        let work = match Work::begin(store, key)? {
            Ok(work) => work,
            Err(holder) => {
                board.wait(at, &holder);
                return Ok(None);
            }
        };
        // Looked up once more: between the first look and the lease, its holder may have committed
        // a result.
        if *reason != Reason::Forced
            && let Lookup::Sound(record) = store.results.lookup(&key)?
        {
            work.abandon()?;
            self.reuse(board, at, record)?;
            return Ok(None);
        }
        if let Reason::Broken(breakage) = reason {
            let text = format!("{breakage}; computing it again");
            board.progress.event(&Event::Warning {
                stage: self.name(at),
                text: &text,
            });
            // With the lease in hand, so that no two processes move the same result, and none a new
            // one.
            store.results.discard(&key, breakage)?;
        }
        Ok(Some(work))
    }

    fn task<'s>(
        &'s self,
        at: usize,
        queued: &Queued,
        work: Work<'s>,
        records: &BTreeMap<usize, Record>,
    ) -> Result<Task<'s>, StoreError> {
        let node = &self.context.graph.nodes[at];
        let outputs = inputs::read(node, |from| self.result(from, records)).into_iter();
        let show = |(input, output): (&str, &Output)| {
            Ok((
                input.to_owned(),
                (work.input(input, output)?, output.digest),
            ))
        };
        let inputs = outputs.map(show).collect::<Result<_, StoreError>>()?;
        let replace = queued.reason == Reason::Forced;
        let extension = extension::extension_key(node.stage.extension(), &queued.manifest);
        // Who forces a stage wants all of it computed.
        let earlier = extension
            .filter(|_| !replace)
            .and_then(|extension| state::latest(self.context.store, &extension));
        let key = queued.key;
        let &Self {
            cancelled,
            checkpoint_every,
            ..
        } = self;
        let device = device_of(&*node.stage, self.device);
        // The record names both devices: its bits are neither those of the GPU nor those of the CPU
        // alone.
        let (device, kind) = match (queued.begun_as, self.context.fallback) {
            (Some(_), Some(kind)) => (&CPU, kind),
            _ => (device, device.kind()),
        };
        Ok(Task {
            node,
            key,
            work,
            inputs,
            device,
            kind,
            cancelled,
            extension,
            earlier,
            checkpoint_every,
            replace,
        })
    }

    /// The rest of a stage whose GPU has failed, for the CPU, under a key of its own; `None` if the
    /// user does not want that.
    pub(super) fn fall_back(
        &self,
        board: &mut Board,
        at: usize,
        ended: &Queued,
        fault: &GpuError,
    ) -> Option<Queued> {
        let inputs = self.inputs(at, &board.outcome.records);
        let manifest = self.context.fallen_manifest(at, &inputs)?;
        let text =
            format!("{fault}; going on on the CPU, from the last checkpoint if there is one");
        board.progress.event(&Event::Warning {
            stage: self.name(at),
            text: &text,
        });
        // On the CPU it does not hold the GPU, so another stage can have that meanwhile.
        let estimate = Estimate {
            device: false,
            ..self.estimate(at, &board.outcome.records)
        };
        let key = manifest.key();
        let reason = ended.reason.clone();
        Some(Queued {
            key,
            manifest,
            reason,
            estimate,
            begun_as: Some(ended.key),
        })
    }

    /// The life of a stage's thread. Nobody listens any more only when the run is over.
    fn work(&self, at: usize, task: Task, sender: &Sender<News>) {
        let begun = Instant::now();
        let say = {
            let sender = sender.clone();
            move |message| drop(sender.send(News::Said(at, message)))
        };
        let result = task.run(self.pool, &say);
        // On the stage's own thread: sending takes long, and the others go on. The result is
        // committed here by now.
        if let (Ok(record), Some(remote)) = (&result, self.context.remote) {
            remote.publish(self.context.store, record);
        }
        let _ = sender.send(News::Ended(
            at,
            Box::new(result),
            begun.elapsed().as_secs_f64(),
        ));
    }
}
