//! All that a running stage may touch: its inputs, its outputs, the device, and whom it tells how
//! far it is. Knows nothing of what a stage computes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use artifacts_schema::{
    Artifact, FigureWriter, Figures, ImageSet, ImageWriter, LatentHeads, LatentWriter, Provenance,
    StoredImages, StoredLatents,
};
use compute::Device;
use formats::Bounds;
use serde::Serialize;

use crate::error::StageError;
use crate::port::Port;

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
        /// The figure, not rounded.
        value: f64,
    },
    /// Done, but not as the user might expect.
    Warning(String),
    /// A warning about the result itself: said again whenever the result is used, also when it is
    /// not computed anew.
    Remark(String),
}

/// All that a running stage may touch.
pub struct Io<'a> {
    /// The seed of its random numbers.
    pub seed: u64,
    /// The device that the user chose; the CPU for a stage that does not use it.
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
    /// Whom it tells; from any thread.
    pub messages: &'a (dyn Fn(Message) + Sync),
    /// Whether the run is being stopped; from any thread.
    pub cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl Io<'_> {
    /// Reads the input artifact of this port.
    pub fn read<A: Artifact>(&self, port: Port<A>) -> Result<A, StageError> {
        Ok(A::read(self.input(port.name)?)?)
    }

    /// The images of this port, to be read view by view: all of them may be larger than memory.
    pub fn images(&self, port: Port<ImageSet>) -> Result<StoredImages, StageError> {
        Ok(StoredImages::open(self.input(port.name)?)?)
    }

    /// The latents, or residuals, of this port, to be read view by view.
    pub fn latents<A: Artifact>(&self, port: Port<A>) -> Result<StoredLatents, StageError> {
        Ok(StoredLatents::open(self.input(port.name)?, A::KIND)?)
    }

    /// The folder of the input of this name.
    pub fn input(&self, name: &str) -> Result<&Path, StageError> {
        self.inputs
            .get(name)
            .map(PathBuf::as_path)
            .ok_or_else(|| StageError::MissingInput(name.to_owned()))
    }

    /// Writes the output artifact of this port.
    pub fn write<A: Artifact>(&self, port: Port<A>, artifact: &A) -> Result<(), StageError> {
        Ok(artifact.write(&self.outputs.join(port.name), &self.provenance)?)
    }

    /// Takes the images of this port one by one. They have a scene box, and a way back to the files
    /// that the scene was read from.
    pub fn image_writer(
        &self,
        port: Port<ImageSet>,
        bounds: Bounds,
        to_source: Option<[[f64; 4]; 4]>,
    ) -> ImageWriter<'_> {
        let folder = self.outputs.join(port.name);
        ImageWriter::new(&folder, bounds, to_source, &self.provenance)
    }

    /// Takes the pictures of this port one by one.
    pub fn figure_writer(&self, port: Port<Figures>) -> Result<FigureWriter<'_>, StageError> {
        let folder = self.outputs.join(port.name);
        Ok(FigureWriter::new(&folder, &self.provenance)?)
    }

    /// Takes the numbers of the latents, or residuals, of this port one by one, in the order of
    /// names.
    pub fn latent_writer<A: Artifact>(
        &self,
        port: Port<A>,
        heads: &LatentHeads,
    ) -> Result<LatentWriter, StageError> {
        let folder = self.outputs.join(port.name);
        let writer = LatentWriter::new(&folder, A::KIND, heads, &self.provenance);
        Ok(writer?)
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
