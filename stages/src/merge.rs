//! `Merge`: joins what the shards of a stage left into what the whole stage would leave. Knows
//! nothing of what they computed.
//!
//! No pipeline names it: it takes the place of a stage with `shards`, when loops are unrolled.

use artifacts_schema::{Artifact, ArtifactKind, Latents, Log, Residuals, StoredImages};
use serde_json::{Value, json};

use crate::error::StageError;
use crate::io::Io;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Determinism, Estimate, Stage};

/// Joins the outputs of shards.
#[derive(Clone, Debug)]
pub struct Merge {
    outputs: Vec<OutputPort>,
    shards: usize,
    parts: Vec<Part>,
    /// Every input reads from a shard, wherever that stands in the pipeline.
    nowhere: Input,
}

/// What one shard left of one output.
#[derive(Clone, Debug)]
pub struct Part {
    /// The merge's input for it: `images.2` for the second shard's images.
    pub input: String,
    /// Which shard, from 0.
    pub shard: usize,
    /// Which of the shard's outputs.
    pub output: OutputPort,
}

impl Part {
    fn new(output: OutputPort, shard: usize) -> Self {
        Self {
            input: format!("{}.{}", output.name, shard + 1),
            shard,
            output,
        }
    }
}

impl Merge {
    /// The stage that joins these outputs of so many shards.
    pub fn new(outputs: Vec<OutputPort>, shards: usize) -> Self {
        let parts = |output: &OutputPort| {
            let output = *output;
            (0..shards).map(move |shard| Part::new(output, shard))
        };
        Self {
            parts: outputs.iter().flat_map(parts).collect(),
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

    /// What it reads: output by output, and shard by shard in each.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    fn join<A: Joined>(&self, output: &OutputPort, io: &Io) -> Result<(), StageError> {
        // Shard by shard, so that a log's lines have one order whichever shard was done first.
        let parts = self.parts.iter().filter(|part| part.output == *output);
        let read = |part: &Part| Ok(A::read(io.input(&part.input)?)?);
        let parts = parts.map(read).collect::<Result<_, StageError>>()?;
        io.write(Port::new(output.name), &A::join(parts)?)
    }
}

impl Merge {
    /// Joins images view by view: all of them may be larger than memory.
    fn join_images(&self, output: &OutputPort, io: &Io) -> Result<(), StageError> {
        let parts = self.parts.iter().filter(|part| part.output == *output);
        let open = |part: &Part| Ok(StoredImages::open(io.input(&part.input)?)?);
        let parts: Vec<StoredImages> = parts.map(open).collect::<Result<_, StageError>>()?;
        // All shards have the bounds of the whole.
        let (first, _) = first(parts.iter().collect())?;
        let mut out = io.image_writer(Port::new(output.name), first.bounds, first.to_source);
        for view in parts.iter().flat_map(StoredImages::views) {
            out.add(view?)?;
        }
        Ok(out.finish()?)
    }
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
        self.parts
            .iter()
            .map(|part| InputPort::new(&part.input, &self.nowhere, part.output.kind))
            .collect()
    }

    fn outputs(&self) -> Vec<OutputPort> {
        self.outputs.clone()
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        let of = |port: &OutputPort| {
            let parts = self.parts.iter().filter(|part| part.output == *port);
            let sizes = parts.map(|part| input(inputs, &part.input));
            (port.name, sizes.fold(Size::default(), Size::and))
        };
        self.outputs.iter().map(of).collect()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let images = inputs.values().copied().filter(|size| size.pixels > 0);
        Estimate::streaming(inputs, images.fold(Size::default(), Size::and), 0)
    }

    fn determinism(&self) -> Determinism {
        // Nothing is computed: parts are put into one order.
        Determinism::Exact
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        for port in &self.outputs {
            match port.kind {
                ArtifactKind::Images => self.join_images(port, io)?,
                ArtifactKind::Latents => self.join::<Latents>(port, io)?,
                ArtifactKind::Residuals => self.join::<Residuals>(port, io)?,
                ArtifactKind::Log => self.join::<Log>(port, io)?,
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

impl Joined for Latents {
    fn join(parts: Vec<Self>) -> Result<Self, StageError> {
        // All shards have the bounds of the whole.
        let (mut all, others) = first(parts)?;
        others.for_each(|part| all.views.extend(part.views));
        // In the order of names, as the whole stage would have left them.
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
