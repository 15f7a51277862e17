//! The ports of a stage: what goes in and out, by name and artifact type. Knows nothing of what
//! happens between them.

use std::marker::PhantomData;

use artifacts_schema::{Artifact, ArtifactKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A reference in a pipeline file: `"stage"` (its first output), `"stage.output"`, or `"@name"` for
/// what a loop carries.
#[derive(
    Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(transparent)]
pub struct Input(pub String);

/// One input that a stage declares.
#[derive(Clone, Copy, Debug)]
pub struct InputPort<'a> {
    /// The name of its field in the pipeline file.
    pub name: &'a str,
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
    pub fn new(name: &'a str, reference: &'a Input, kind: ArtifactKind) -> Self {
        Self {
            name,
            reference,
            kind,
            used: true,
        }
    }

    /// An input that the stage uses on a condition.
    pub fn only_if(self, used: bool) -> Self {
        Self { used, ..self }
    }
}

/// One output that a stage declares. The first one is meant where a reference names the stage
/// alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputPort {
    /// What a reference says behind the stage's name: `stage.name`.
    pub name: &'static str,
    /// The artifact type that it writes.
    pub kind: ArtifactKind,
}

/// A port of a stage, with its artifact type. One constant of this type is what the stage declares,
/// reads and writes it by.
#[derive(Debug)]
pub struct Port<A> {
    /// The name of an input's field, or of an output.
    pub name: &'static str,
    artifact: PhantomData<A>,
}

impl<A: Artifact> Port<A> {
    /// The port of this name.
    pub const fn new(name: &'static str) -> Self {
        Self {
            name,
            artifact: PhantomData,
        }
    }

    /// The input that it declares, with what the pipeline file says there.
    pub fn input(self, reference: &Input) -> InputPort<'_> {
        InputPort::new(self.name, reference, A::KIND)
    }

    /// The output that it declares.
    pub fn output(self) -> OutputPort {
        OutputPort {
            name: self.name,
            kind: A::KIND,
        }
    }
}
