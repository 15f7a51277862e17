//! `Merge`: joins what the shards of a stage left into what the whole stage would leave. Knows
//! nothing of what they computed.
//!
//! No pipeline names it: it takes the place of a stage with `shards`, when loops are unrolled.

use std::path::Path;

use artifacts_schema::{
    Artifact, ArtifactKind, LatentHeads, Latents, Log, Residuals, SchemaError, StoredImages,
    StoredLatents,
};
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

    /// What the shards left of an output, in the order of shards.
    fn read<T>(
        &self,
        output: &OutputPort,
        io: &Io,
        read: impl Fn(&Path) -> Result<T, SchemaError>,
    ) -> impl Iterator<Item = Result<T, StageError>> {
        let parts = self.parts.iter().filter(|part| part.output == *output);
        parts.map(move |part| Ok(read(io.input(&part.input)?)?))
    }

    /// Joins images view by view: all of them may be larger than memory.
    fn join_images(&self, output: &OutputPort, io: &Io) -> Result<(), StageError> {
        let parts = self.read(output, io, StoredImages::open);
        let parts: Vec<StoredImages> = parts.collect::<Result<_, _>>()?;
        // All shards have the bounds of the whole.
        let first = first(&parts)?;
        let mut out = io.image_writer(Port::new(output.name), first.bounds, first.to_source);
        for view in parts.iter().flat_map(StoredImages::views) {
            out.add(view?)?;
        }
        Ok(out.finish()?)
    }

    /// Joins latents, or residuals, view by view.
    fn join_latents<A: Artifact>(&self, output: &OutputPort, io: &Io) -> Result<(), StageError> {
        let parts = self.read(output, io, |folder| StoredLatents::open(folder, A::KIND));
        let parts: Vec<StoredLatents> = parts.collect::<Result<_, _>>()?;
        let views = parts.iter().flat_map(|part| {
            let heads = part.heads().views.iter().enumerate();
            heads.map(move |(at, head)| (head, part, at))
        });
        let mut views: Vec<_> = views.collect();
        // In the order of names, as the whole stage would have left them.
        views.sort_by(|(a, ..), (b, ..)| a.name.cmp(&b.name));
        let heads = LatentHeads {
            views: views.iter().map(|(head, ..)| (*head).clone()).collect(),
            // All shards have the bounds of the whole.
            ..first(&parts)?.heads().clone()
        };
        let mut out = io.latent_writer(Port::<A>::new(output.name), &heads)?;
        for (head, part, at) in views {
            out.add(&head.name, &part.view(at)?.tensor)?;
        }
        Ok(out.finish()?)
    }

    /// Joins logs, shard after shard; every line says whose it is.
    fn join_logs(&self, output: &OutputPort, io: &Io) -> Result<(), StageError> {
        let mut joined = Log::default();
        for (shard, log) in self.read(output, io, Log::read).enumerate() {
            let mark = |mut line: Value| {
                // Steps are counted from 0 in every shard, so that lines alone would be ambiguous.
                line["shard"] = json!(shard + 1);
                line
            };
            joined.lines.extend(log?.lines.into_iter().map(mark));
        }
        io.write(Port::new(output.name), &joined)
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
        // Parts are read one after the other, so that they take what the whole would.
        let joined = self.foretell(inputs);
        let viewed = joined.values().copied().filter(|size| size.largest > 0);
        Estimate::streaming(&joined, viewed.fold(Size::default(), Size::and), 0)
    }

    fn determinism(&self) -> Determinism {
        // Nothing is computed: parts are put into one order.
        Determinism::Exact
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        for port in &self.outputs {
            match port.kind {
                ArtifactKind::Images => self.join_images(port, io)?,
                ArtifactKind::Latents => self.join_latents::<Latents>(port, io)?,
                ArtifactKind::Residuals => self.join_latents::<Residuals>(port, io)?,
                ArtifactKind::Log => self.join_logs(port, io)?,
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

/// The first part; an error where there is none.
fn first<A>(parts: &[A]) -> Result<&A, StageError> {
    let none = || StageError::Mismatch("there are no shards to join".into());
    parts.first().ok_or_else(none)
}
