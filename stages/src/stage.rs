//! What a stage is: a pure function from parameters, input artifacts and a seed to output
//! artifacts.
//!
//! Knows nothing of the runner: not of keys, the store, other stages or the terminal.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use artifacts_schema::{Artifact, ArtifactKind, Digest, Provenance};
use compute::Device;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::StageError;
use crate::registry::AnyStage;

/// A reference in a pipeline file: `"stage"` (its first output), `"stage.output"`, or `"@name"` for
/// what a loop carries.
#[derive(
    Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(transparent)]
pub struct Input(pub String);

/// One input that a stage declares; `name` is the name of its field in the pipeline file.
#[derive(Clone, Copy, Debug)]
pub struct InputPort<'a> {
    /// The field's name.
    pub name: &'static str,
    /// What the pipeline file says there.
    pub reference: &'a Input,
    /// The artifact type that it takes.
    pub kind: ArtifactKind,
    /// Whether the parameters make use of it. Where not, it may stay unconnected, and what it says
    /// changes nothing.
    pub used: bool,
}

impl<'a> InputPort<'a> {
    /// An input that the stage uses.
    pub fn new(name: &'static str, reference: &'a Input, kind: ArtifactKind) -> Self {
        Self {
            name,
            reference,
            kind,
            used: true,
        }
    }

    /// The same, used only on a condition.
    pub fn only_if(self, used: bool) -> Self {
        Self { used, ..self }
    }
}

/// One output that a stage declares. The first one is meant where a reference names the stage
/// alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputPort {
    /// The output's name.
    pub name: &'static str,
    /// The artifact type that it writes.
    pub kind: ArtifactKind,
}

/// Something that a stage reads beside its inputs, photos or model weights: it belongs to the
/// stage's key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// What it is, in words that `explain` prints (never a path: moving a folder changes nothing).
    pub name: String,
    /// The digest of its content.
    pub digest: Digest,
}

/// How far equal inputs give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Determinism {
    /// The same bits on every device.
    Exact,
    /// The same bits on every device of one kind (all CPUs, or one GPU adapter).
    PerDeviceKind,
}

/// Whether more steps may go on from the state that fewer left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extension {
    /// The stage has no steps to add to.
    None,
    /// They may: step n does not depend on the number of steps, which this parameter says.
    Possible(&'static str),
    /// They may not: what a step does depends on their number, which this parameter says, in the
    /// way told.
    Impossible(&'static str, &'static str),
}

/// What a stage will take, roughly: enough to choose what runs beside what, and what to ask of a
/// cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Bytes of main memory at the worst moment.
    pub memory: u64,
    /// Seconds on two cores.
    pub seconds: f64,
    /// Whether it computes on the device, which one stage holds at a time where that is a GPU.
    pub device: bool,
}

impl Estimate {
    /// Of a stage that reads all of its inputs and does little with them.
    pub fn reading(inputs: &Sizes) -> Self {
        let bytes: u64 = inputs.values().sum();
        Self {
            memory: (64 << 20) + 6 * bytes,
            seconds: 1.0 + bytes as f64 / 1e7,
            device: false,
        }
    }

    /// The same, if it computes on the device as well, in so many more bytes and seconds.
    pub fn computing(self, memory: u64, seconds: f64) -> Self {
        Self {
            memory: self.memory + memory,
            seconds: self.seconds + seconds,
            device: true,
        }
    }
}

/// Bytes of input artifacts by input name, as far as they are known.
pub type Sizes<'a> = BTreeMap<&'a str, u64>;

/// One step of a pipeline. A stage kind is a struct whose fields are its inputs and parameters,
/// with its defaults in `Default`.
pub trait Stage: Send + Sync {
    /// The kind's name in pipeline files.
    fn kind(&self) -> &'static str;
    /// Raised whenever the outputs for the same inputs change.
    fn version(&self) -> u32;
    /// Refuses parameters that make no sense, by field, before anything runs.
    fn check(&self) -> Result<(), StageError>;
    /// The inputs, in a fixed order.
    fn inputs(&self) -> Vec<InputPort<'_>>;
    /// The outputs, in a fixed order.
    fn outputs(&self) -> Vec<OutputPort>;
    /// Parameters that say where something lies, not what it is, as paths in which variant names
    /// are left out (`source.path`): they stay out of the key, since [`Stage::sources`] covers the
    /// content.
    fn locations(&self) -> &'static [&'static str] {
        &[]
    }
    /// What it reads beside its inputs.
    fn sources(&self) -> Result<Vec<Source>, StageError> {
        Ok(Vec::new())
    }
    /// All files and folders that [`Stage::sources`] looks into: while none of them changes, its
    /// answer stands. `None` where that cannot be said.
    fn source_files(&self) -> Option<Vec<PathBuf>> {
        // A stage that names places has files there, of which it alone knows.
        self.locations().is_empty().then(Vec::new)
    }
    /// How far equal inputs give equal bits.
    fn determinism(&self) -> Determinism {
        // A GPU adds up in another order than a CPU.
        Determinism::PerDeviceKind
    }
    /// Whether it computes on the device that the user chose. All others compute on the CPU
    /// whatever was chosen.
    fn uses_device(&self) -> bool {
        false
    }
    /// Whether a result of more steps may go on from one of fewer.
    fn extension(&self) -> Extension {
        Extension::None
    }
    /// Memory and time that it will take. By default those of a stage that reads all of its inputs
    /// and does little with them.
    fn estimate(&self, inputs: &Sizes) -> Estimate {
        Estimate::reading(inputs)
    }
    /// The stages that compute it part by part, each some of the views; none where it is computed
    /// as a whole. [`crate::Merge`] joins what they leave.
    fn shards(&self) -> Vec<AnyStage> {
        Vec::new()
    }
    /// Reads the inputs, computes, writes every output.
    fn run(&self, io: &Io) -> Result<(), StageError>;
}

/// What a running stage says. Others turn it into bars, JSON lines or logs.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Message {
    /// `step` of `total` is done; `values` are the current loss, PSNR and so on.
    Progress {
        /// Steps done.
        step: u64,
        /// Steps in all.
        total: u64,
        /// Named figures of the last step.
        values: Vec<(&'static str, f64)>,
    },
    /// It goes on from where an earlier run left it.
    Resumed {
        /// Steps done.
        step: u64,
        /// Steps in all.
        total: u64,
        /// Whether these steps are a finished result's, which is extended; else they are an
        /// interrupted run's.
        finished: bool,
    },
    /// A result worth a line of its own.
    Metric {
        /// What it measures.
        name: String,
        /// Its value.
        value: f64,
    },
    /// Done, but not as the user might expect.
    Warning(String),
    /// The same about the result itself: said again whenever the result is used, also when it is
    /// not computed anew.
    Remark(String),
}

/// All that a running stage may touch.
pub struct Io<'a> {
    /// The seed of its random numbers.
    pub seed: u64,
    /// Where it computes.
    pub device: &'a Device,
    /// Folders of the input artifacts, by input name.
    pub inputs: BTreeMap<String, PathBuf>,
    /// The folder under which each output gets a folder of its name.
    pub outputs: PathBuf,
    /// Private to this stage's key and kept until its result is committed: the place for
    /// checkpoints.
    pub scratch: PathBuf,
    /// How long to go on between two checkpoints; zero for one after every step. No result depends
    /// on it.
    pub checkpoint_every: Duration,
    /// The last state of a finished result that differs from this one in having fewer steps, if
    /// there is any.
    pub earlier: Option<PathBuf>,
    /// What the artifacts say of their origin.
    pub provenance: Provenance,
    /// Takes messages.
    pub messages: &'a (dyn Fn(Message) + Sync),
    /// Whether to stop.
    pub cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl Io<'_> {
    /// Reads the input artifact of this name.
    pub fn read<A: Artifact>(&self, name: &str) -> Result<A, StageError> {
        Ok(A::read(self.input(name)?)?)
    }

    /// The folder of the input of this name.
    pub fn input(&self, name: &str) -> Result<&Path, StageError> {
        self.inputs
            .get(name)
            .map(PathBuf::as_path)
            .ok_or_else(|| StageError::MissingInput(name.to_owned()))
    }

    /// Writes the output artifact of this name.
    pub fn write<A: Artifact>(&self, name: &str, artifact: &A) -> Result<(), StageError> {
        Ok(artifact.write(&self.outputs.join(name), &self.provenance)?)
    }

    /// Reports progress; an error when the run is being stopped.
    pub fn progress(
        &self,
        step: usize,
        total: usize,
        values: &[(&'static str, f64)],
    ) -> Result<(), StageError> {
        (self.messages)(Message::Progress {
            step: step as u64,
            total: total as u64,
            values: values.to_vec(),
        });
        // Every step that is reported is a place to stop, so that no stage has to ask for itself.
        self.check_cancelled()
    }

    /// Reports a result worth a line of its own.
    pub fn metric(&self, name: impl Into<String>, value: f64) {
        (self.messages)(Message::Metric {
            name: name.into(),
            value,
        });
    }

    /// Reports something that the user might not expect.
    pub fn warn(&self, text: impl Into<String>) {
        (self.messages)(Message::Warning(text.into()));
    }

    /// Reports something about the result that the user might not expect, whenever the result is
    /// used.
    pub fn remark(&self, text: impl Into<String>) {
        (self.messages)(Message::Remark(text.into()));
    }

    /// An error when the run is being stopped.
    pub fn check_cancelled(&self) -> Result<(), StageError> {
        if (self.cancelled)() {
            Err(StageError::Cancelled)
        } else {
            Ok(())
        }
    }
}
