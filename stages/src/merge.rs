//! `Merge`: joins what the shards of a stage left into what the whole stage would leave. Knows
//! nothing of what they computed.
//!
//! No pipeline names it: it takes the place of a stage with `shards`, when loops are unrolled.

use std::collections::BTreeSet;
use std::sync::Mutex;

use artifacts_schema::{Artifact, ArtifactKind, ImageSet, Latents, Log, Residuals};
use serde_json::{Value, json};

use crate::error::StageError;
use crate::stage::{Determinism, Input, InputPort, Io, OutputPort, Stage};

/// Joins the outputs of shards.
#[derive(Clone, Debug)]
pub struct Merge {
    outputs: Vec<OutputPort>,
    shards: usize,
    /// Every input reads from a shard, wherever that stands in the pipeline.
    nowhere: Input,
}

impl Merge {
    /// The stage that joins these outputs of so many shards.
    pub fn new(outputs: Vec<OutputPort>, shards: usize) -> Self {
        Self {
            outputs,
            shards,
            nowhere: Input::default(),
        }
    }

    /// Its parameters as text.
    pub fn parameters(&self) -> Value {
        let names: Vec<&str> = self.outputs.iter().map(|port| port.name).collect();
        json!({ "outputs": names, "shards": self.shards })
    }

    /// Its inputs: name, which shard (from 0), and which of that shard's outputs.
    pub fn wires(&self) -> Vec<(&'static str, usize, &'static str)> {
        let shards = |port: &OutputPort| {
            (0..self.shards)
                .map(|shard| (shard, *port))
                .collect::<Vec<_>>()
        };
        let all = self.outputs.iter().flat_map(shards);
        all.map(|(shard, port)| (input(port.name, shard), shard, port.name))
            .collect()
    }

    fn join<A: Joined>(&self, output: &'static str, io: &Io) -> Result<(), StageError> {
        // Shard by shard, so that a log's lines have one order whichever shard was done first.
        let parts = (0..self.shards)
            .map(|shard| io.read(input(output, shard)))
            .collect::<Result<Vec<A>, _>>()?;
        io.write(output, &A::join(parts)?)
    }
}

/// `images.2` for the second shard's images. There are as many such names as the largest merge has
/// inputs, and they are kept.
fn input(output: &str, shard: usize) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let name = format!("{output}.{}", shard + 1);
    let mut names = NAMES
        .lock()
        // A set of names is sound whatever another thread panicked over.
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    if let Some(known) = names.get(name.as_str()) {
        return known;
    }
    // A port's name is `&'static str` since all other stages' are.
    let kept: &'static str = Box::leak(name.into_boxed_str());
    names.insert(kept);
    kept
}

impl Stage for Merge {
    fn kind(&self) -> &'static str {
        "Merge"
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<(), StageError> {
        Ok(())
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        let kind = |output: &str| {
            self.outputs
                .iter()
                .find(|port| port.name == output)
                .map(|port| port.kind)
        };
        let port = |(name, _, output)| Some(InputPort::new(name, &self.nowhere, kind(output)?));
        self.wires().into_iter().filter_map(port).collect()
    }

    fn outputs(&self) -> Vec<OutputPort> {
        self.outputs.clone()
    }

    fn determinism(&self) -> Determinism {
        // Nothing is computed: parts are put into one order.
        Determinism::Exact
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        for port in &self.outputs {
            match port.kind {
                ArtifactKind::Images => self.join::<ImageSet>(port.name, io)?,
                ArtifactKind::Latents => self.join::<Latents>(port.name, io)?,
                ArtifactKind::Residuals => self.join::<Residuals>(port.name, io)?,
                ArtifactKind::Log => self.join::<Log>(port.name, io)?,
                kind => {
                    return Err(StageError::Mismatch(format!(
                        "{kind} of several shards cannot be joined"
                    )));
                }
            }
        }
        Ok(())
    }
}

/// An artifact that can be joined from parts; each part has views of its own.
trait Joined: Artifact {
    fn join(parts: Vec<Self>) -> Result<Self, StageError>;
}

/// The first part, and the others behind it; an error where there is none.
fn first<A>(parts: Vec<A>) -> Result<(A, impl Iterator<Item = A>), StageError> {
    let mut parts = parts.into_iter();
    let first = parts
        .next()
        .ok_or_else(|| StageError::Mismatch("there are no shards to join".into()))?;
    Ok((first, parts))
}

impl Joined for ImageSet {
    fn join(parts: Vec<Self>) -> Result<Self, StageError> {
        // All shards have the bounds of the whole.
        let (mut all, others) = first(parts)?;
        others.for_each(|part| all.views.extend(part.views));
        // In the order of names, as the whole stage would have left them.
        all.views.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(all)
    }
}

impl Joined for Latents {
    fn join(parts: Vec<Self>) -> Result<Self, StageError> {
        let (mut all, others) = first(parts)?;
        others.for_each(|part| all.views.extend(part.views));
        all.views.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(all)
    }
}

impl Joined for Residuals {
    fn join(parts: Vec<Self>) -> Result<Self, StageError> {
        Ok(Self(Latents::join(
            parts.into_iter().map(|Self(latents)| latents).collect(),
        )?))
    }
}

impl Joined for Log {
    /// Shard after shard; every line says whose it is.
    fn join(parts: Vec<Self>) -> Result<Self, StageError> {
        let marked = |(shard, log): (usize, Self)| {
            let mark = move |mut line: Value| {
                // Steps are counted from 0 in every shard, so that lines alone would be ambiguous.
                line["shard"] = json!(shard + 1);
                line
            };
            log.lines.into_iter().map(mark)
        };
        Ok(Self {
            lines: parts.into_iter().enumerate().flat_map(marked).collect(),
        })
    }
}
