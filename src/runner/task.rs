//! One stage run to its end: computed, committed, or failed in one of a few ways. Knows nothing of
//! other stages.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use artifacts_schema::{ArtifactKind, Digest, Provenance, SchemaError};
use compute::device::attempt;
use compute::{Device, GpuError};
use stages::{Io, Message, Stage, StageError};

use crate::pipeline::graph::Node;
use crate::runner::peak::watched;
use crate::store::error::StoreError;
use crate::store::leases::holder::Holder;
use crate::store::record::Record;
use crate::store::work::{Facts, Work};

/// Why a stage has no result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// It says so itself.
    #[error(transparent)]
    Stage(StageError),
    /// The device on which it computed has failed.
    #[error(transparent)]
    Device(GpuError),
    /// Its result could not be kept.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// It has a bug.
    #[error("internal error: {0}; this is a bug in srnerf-dag, please report it")]
    Bug(String),
    /// Another process took the stage over, since this one gave no sign of life for long.
    #[error("{0} has taken the stage over")]
    Lost(Holder),
    /// The run is being stopped.
    #[error("stopped")]
    Stopped,
}

impl Failure {
    /// What to tell people: what happened, and how to mend it where that is known.
    pub fn text(&self) -> String {
        match self {
            Self::Store(StoreError::Io {
                help: Some(help), ..
            }) => format!("{self}; {help}"),
            _ => self.to_string(),
        }
    }
}

/// A stage about to run.
pub struct Task<'a> {
    /// The stage.
    pub node: &'a Node,
    pub key: Digest,
    /// Its folder.
    pub work: Work<'a>,
    /// The folders and digests of its inputs.
    pub inputs: BTreeMap<String, (PathBuf, Digest)>,
    /// Where it computes.
    pub device: &'a Device,
    /// What that is called in its record and its provenance.
    pub kind: &'a str,
    /// Set when it should stop.
    pub cancelled: &'a AtomicBool,
    /// The extension key: what it has in common with results of fewer steps, if a longer run can go
    /// on from a shorter one.
    pub extension: Option<Digest>,
    /// The state that such a result left.
    pub earlier: Option<PathBuf>,
    /// How often it keeps checkpoints.
    pub checkpoint_every: Duration,
    /// Whether its result replaces an earlier one.
    pub replace: bool,
}

impl Task<'_> {
    /// Runs the stage in a pool of threads and commits its result. No panic gets out.
    pub fn run(
        self,
        pool: &rayon::ThreadPool,
        messages: &(dyn Fn(Message) + Sync),
    ) -> Result<Record, Failure> {
        let begun = Instant::now();
        let remarks = Mutex::new(Vec::new());
        let messages = |message| {
            if let (Message::Remark(text), Ok(mut remarks)) = (&message, remarks.lock()) {
                remarks.push(text.clone());
            }
            messages(message);
        };
        let compute = || {
            catch_unwind(AssertUnwindSafe(|| {
                pool.install(|| self.compute(&messages))
            }))
        };
        // `watched` needs work that does not panic: its watcher would never be told to stop.
        let (end, peak_memory) = watched(compute);
        // Whatever came of it: the key is another's, and so are its checkpoint and its result.
        if let Some(holder) = self.work.lost_to() {
            return Err(Failure::Lost(holder));
        }
        match end {
            Ok(Ok(())) => {
                // Before the commit, which removes the checkpoint with the rest of the folder.
                self.extension
                    .map_or(Ok(()), |extension| self.work.keep_state(&extension))?;
                let outputs: Vec<(&str, ArtifactKind)> = self
                    .node
                    .stage
                    .outputs()
                    .iter()
                    .map(|port| (port.name, port.kind))
                    .collect();
                let stage = self.node.name.clone();
                let device = self.kind.to_owned();
                let facts = Facts {
                    stage,
                    seconds: begun.elapsed().as_secs_f64(),
                    device,
                    remarks: remarks.into_inner().unwrap_or_default(),
                    peak_memory,
                };
                // In the pool, since digests are taken by all threads.
                Ok(pool.install(|| self.work.commit(&outputs, facts, self.replace))?)
            }
            Ok(Err(error)) => {
                let outputs = self.work.outputs();
                // The checkpoint stays, for the next run to go on from.
                self.work.abandon()?;
                Err(failure(error, &outputs))
            }
            Err(panic) => {
                self.work.abandon()?;
                Err(Failure::Bug(panic_text(&*panic)))
            }
        }
    }

    fn compute(&self, messages: &(dyn Fn(Message) + Sync)) -> Result<(), StageError> {
        let io = Io {
            seed: self.node.seed,
            device: self.device,
            inputs: self
                .inputs
                .iter()
                .map(|(name, (folder, _))| (name.clone(), folder.clone()))
                .collect(),
            outputs: self.work.outputs(),
            scratch: self.work.scratch(),
            checkpoint_every: self.checkpoint_every,
            earlier: self.earlier.clone(),
            provenance: self.provenance(),
            messages,
            // A stage that has lost its lease stops as if the run did: what it computes would not
            // be used.
            cancelled: &|| self.cancelled.load(Ordering::Relaxed) || self.work.is_lost(),
        };
        // Operators return no errors: a fault of the GPU unwinds to `attempt`.
        attempt(|| self.node.stage.run(&io))?
    }

    fn provenance(&self) -> Provenance {
        Provenance {
            program: format!("srnerf-dag {}", env!("CARGO_PKG_VERSION")),
            stage: self.node.name.clone(),
            kind: self.node.stage.kind().to_owned(),
            version: self.node.stage.version().to_string(),
            key: self.key.to_string(),
            device: self.kind.to_owned(),
            params: self.node.params.clone(),
            inputs: self
                .inputs
                .iter()
                .map(|(name, (_, digest))| (name.clone(), digest.to_string()))
                .collect(),
        }
    }
}

/// What computes where no GPU is chosen.
pub static CPU: Device = Device::cpu();

/// Where a stage computes, if the user chose `chosen`.
pub fn device_of<'d>(stage: &dyn Stage, chosen: &'d Device) -> &'d Device {
    if stage.uses_device() { chosen } else { &CPU }
}

/// What the error of a stage is to the run. That its outputs cannot be written is the store's.
fn failure(error: StageError, outputs: &Path) -> Failure {
    match error {
        StageError::Cancelled => Failure::Stopped,
        StageError::Device(fault) => Failure::Device(fault),
        // A full disk is not the stage's fault. An input that cannot be read is told as the stage's
        // error.
        StageError::Artifact(SchemaError::Io { path, source }) if path.starts_with(outputs) => {
            Failure::Store(StoreError::io("write", &path, source))
        }
        other => Failure::Stage(other),
    }
}

/// Where the latest panic happened.
static LATEST: Mutex<Option<String>> = Mutex::new(None);

/// Keeps panics off the terminal: they are reported as errors, with their place.
pub fn quiet_panics() {
    std::panic::set_hook(Box::new(|info| {
        // The place is known only here, and whoever catches the panic sees only its text.
        if let (Ok(mut latest), Some(place)) = (LATEST.lock(), info.location()) {
            *latest = Some(format!("{}:{}", place.file(), place.line()));
        }
    }));
}

/// What a panic said, and where.
pub fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or(panic.downcast_ref::<&str>().copied());
    let place = LATEST.lock().ok().and_then(|mut latest| latest.take());
    match place {
        Some(place) => format!("{} at {place}", text.unwrap_or("panic")),
        None => text.unwrap_or("panic").to_owned(),
    }
}
