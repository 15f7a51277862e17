//! What a stage is: a pure function from parameters, input artifacts and a seed to output
//! artifacts.
//!
//! Knows nothing of the runner: not of keys, the store, other stages or the terminal.

use std::path::PathBuf;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};

use crate::error::StageError;
use crate::io::Io;
use crate::model::Model;
use crate::port::{InputPort, OutputPort};
use crate::registry::AnyStage;
use crate::size::{Foretold, Size, Sizes};

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

/// Seconds of two cores for a ray through a field (docs/performance.md).
pub const RAY_SECONDS: f64 = 1.4e-5;
/// Seconds of two cores for a pixel of an image that is written.
pub const WRITTEN_SECONDS: f64 = 1.5e-7;

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
    /// Of so many bytes and seconds, beside what any stage takes.
    pub fn of(memory: u64, seconds: f64) -> Self {
        Self {
            memory: (64 << 20) + memory,
            seconds: 1.0 + seconds,
            device: false,
        }
    }

    /// Of a stage that reads all of its inputs at once and does little with them.
    pub fn reading(inputs: &Sizes) -> Self {
        let memory = inputs.values().map(Size::whole).sum();
        Self::of(memory, reading_seconds(inputs))
    }

    /// Of a stage that goes through its inputs' images and latents view by view, each of which takes `pixel`
    /// bytes for each of its pixels while it is worked on, and writes images in the same way.
    pub fn streaming(inputs: &Sizes, written: Size, pixel: u64) -> Self {
        let read = inputs.values().map(|size| match size.largest {
            0 => size.whole(),
            _ => size.held(),
        });
        // Twice, since a view that is written is in memory as numbers and as a file.
        let memory = read.sum::<u64>() + 2 * written.waiting() + pixel * written.largest;
        let seconds = reading_seconds(inputs) + written.pixels as f64 * WRITTEN_SECONDS;
        Self::of(memory, seconds)
    }

    /// Of a stage that computes on the device as well, in so many more bytes and seconds.
    pub fn computing(self, memory: u64, seconds: f64) -> Self {
        Self {
            memory: self.memory + memory,
            seconds: self.seconds + seconds,
            device: true,
        }
    }
}

fn reading_seconds(inputs: &Sizes) -> f64 {
    inputs.values().map(|size| size.bytes).sum::<u64>() as f64 / 1e8
}

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
    /// The network that its parameters name, if there is one. It answers the next three questions
    /// where a stage reads nothing else beside its inputs.
    fn model(&self) -> Option<&dyn Model> {
        None
    }
    /// Parameters that say where something lies, not what it is, as paths in which variant names
    /// are left out (`source.path`): they stay out of the key, since [`Stage::sources`] covers the
    /// content.
    fn locations(&self) -> &'static [&'static str] {
        self.model().map_or(&[], |model| model.locations())
    }
    /// What it reads beside its inputs.
    fn sources(&self) -> Result<Vec<Source>, StageError> {
        let source = |model: &dyn Model| {
            Ok(Source {
                name: "model".into(),
                digest: model.content()?,
            })
        };
        self.model().into_iter().map(source).collect()
    }
    /// All files and folders that [`Stage::sources`] looks into: while none of them changes, its
    /// answer stands. `None` where that cannot be said.
    fn source_files(&self) -> Option<Vec<PathBuf>> {
        match self.model() {
            Some(model) => model.files(),
            // A stage that names places has files there, of which it alone knows.
            None => self.locations().is_empty().then(Vec::new),
        }
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
    /// How large its outputs will be. The stages that read them are estimated by it; an output that
    /// it does not name counts as empty.
    fn foretell(&self, _inputs: &Sizes) -> Foretold {
        Foretold::new()
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
