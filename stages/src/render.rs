//! `Render`: images of a field from given cameras, with depth and opacity. Knows nothing of how the field was trained.

use artifacts_schema::{ArtifactKind, Field, ImageSet};
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::stage::{Estimate, Input, InputPort, Io, OutputPort, Sizes, Stage};

/// Renders a field from the cameras of an image set.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Render {
    /// The field.
    pub field: Input,
    /// The image set whose cameras (and names) are used.
    pub cameras: Input,
    /// Size of the images over the size of the cameras' own images.
    pub scale: f64,
    /// Rays per pixel and axis, averaged.
    pub supersample: u32,
    /// In how many parts the views are rendered, each a stage of its own; the images are the same for any number.
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

impl Default for Render {
    fn default() -> Self {
        Self { field: Input::default(), cameras: Input::default(), scale: 1.0, supersample: 1, shards: 1, shard: 0 }
    }
}

impl Stage for Render {
    fn kind(&self) -> &'static str {
        "Render"
    }

    fn version(&self) -> u32 {
        2
    }

    fn check(&self) -> Result<(), StageError> {
        if !(self.scale > 0.0 && self.scale <= 64.0) {
            return Err(StageError::parameter(
                "scale",
                format!("is {}; it must be above 0 and at most 64", self.scale),
            ));
        }
        convert::in_range("supersample", self.supersample, 1, 16)?;
        shard::check(self.shards, self.shard)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            InputPort::new("field", &self.field, ArtifactKind::Field),
            InputPort::new("cameras", &self.cameras, ArtifactKind::Images),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![OutputPort { name: "images", kind: ArtifactKind::Images }]
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| AnyStage::Render(Self { shard, ..self.clone() }))
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        Estimate::reading(inputs).computing(64 << 20, 30.0)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let field = convert::field(io.read::<Field>("field")?)?;
        let cameras: ImageSet = io.read("cameras")?;
        let options = nerf::RenderOptions { supersample: self.supersample, ..Default::default() };
        let seen = Shard::new(self.shards, self.shard).take(cameras.views)?;
        let mut views = Vec::new();
        for (done, view) in seen.iter().enumerate() {
            let camera = convert::scaled(&convert::camera(&view.camera), self.scale);
            views.push(convert::rendered_view(&view.name, &camera, nerf::render(&field, &camera, &options)));
            io.progress(done + 1, seen.len(), &[])?;
        }
        io.write("images", &ImageSet { views, bounds: cameras.bounds })
    }
}
