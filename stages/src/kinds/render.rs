//! `Render`: images of a field from given cameras or along a path, with depth and opacity. Knows
//! nothing of how the field was trained.

use std::path::PathBuf;

use artifacts_schema::{Digest, Field, ImageSet, StoredImages};
use formats::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Estimate, RAY_SECONDS, Source, Stage};

const FIELD: Port<Field> = Port::new("field");
const CAMERAS: Port<ImageSet> = Port::new("cameras");
const IMAGES: Port<ImageSet> = Port::new("images");

/// Bytes of a pixel while it is rendered.
const RENDERED: u64 = 64;

/// Renders a field from the cameras of an image set. Where the images that the cameras come from
/// have alpha, or along a path, the renders have it too.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Render {
    /// The field.
    pub field: Input,
    /// The image set whose cameras (and names) are used.
    pub cameras: Input,
    /// A path among these cameras to render instead: frames `frame_0000`, `frame_0001` …
    pub path: Option<CameraPath>,
    /// Size of the images over the size of the cameras' own images.
    #[schemars(range(max = 64), extend("exclusiveMinimum" = 0))]
    pub scale: f64,
    /// Rays per pixel and axis, averaged.
    #[schemars(range(min = 1, max = 16))]
    pub supersample: u32,
    /// In how many parts the views are rendered, each a stage of its own; the images are the same
    /// for any number.
    #[schemars(range(min = 1))]
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

/// A path for a camera to fly.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub enum CameraPath {
    /// About the average camera, as wide as the cameras stand apart: for scenes photographed from
    /// one side.
    Spiral {
        /// Images in all.
        #[serde(default = "default_frames")]
        #[schemars(range(min = 1, max = 100_000))]
        frames: u32,
        /// Turns in all.
        #[serde(default = "default_turns")]
        #[schemars(range(max = 1000), extend("exclusiveMinimum" = 0))]
        turns: f64,
    },
    /// Once around what all cameras look at: for objects photographed from all around.
    Circle {
        /// Images in all.
        #[serde(default = "default_frames")]
        #[schemars(range(min = 1, max = 100_000))]
        frames: u32,
    },
    /// The poses of a `transforms.json`, in its order, in the scene's own coordinates.
    File {
        /// The file.
        path: PathBuf,
    },
}

fn default_frames() -> u32 {
    60
}

fn default_turns() -> f64 {
    2.0
}

impl Default for Render {
    fn default() -> Self {
        let none = Input::default;
        Self {
            field: none(),
            cameras: none(),
            path: None,
            scale: 1.0,
            supersample: 1,
            shards: 1,
            shard: 0,
        }
    }
}

impl Render {
    fn part(&self) -> Shard {
        Shard::new(self.shards, self.shard)
    }

    /// How large the images will be.
    fn rendered(&self, inputs: &Sizes) -> Size {
        let own = input(inputs, CAMERAS.name).scaled(self.scale);
        let views = match &self.path {
            None | Some(CameraPath::File { .. }) => own.views,
            Some(CameraPath::Spiral { frames, .. } | CameraPath::Circle { frames }) => {
                u64::from(*frames)
            }
        };
        // With depth.
        self.part().size(Size {
            views,
            pixels: views * own.largest,
            bytes: 16 * views * own.largest,
            ..own
        })
    }

    /// What to render, by name.
    fn views(&self, cameras: &StoredImages) -> Result<Vec<(String, Camera)>, StageError> {
        let own: Vec<Camera> = cameras
            .cameras()
            .iter()
            .map(|(_, camera)| *camera)
            .collect();
        if own.is_empty() {
            return Err(StageError::Mismatch(
                "there are no cameras to render from".into(),
            ));
        }
        let path = match &self.path {
            None => return Ok(cameras.cameras().to_vec()),
            Some(CameraPath::Spiral { frames, turns }) => scene::spiral(&own, *frames, *turns),
            Some(CameraPath::Circle { frames }) => scene::circle(&own, *frames),
            Some(CameraPath::File { path }) => scene::path_from_file(path, &own)?,
        };
        // Of one width, so that names sort as frames follow; four digits at least.
        let digits = path.len().saturating_sub(1).to_string().len().max(4);
        Ok(path
            .into_iter()
            .enumerate()
            .map(|(i, camera)| (format!("frame_{i:0digits$}"), camera))
            .collect())
    }
}

impl Stage for Render {
    fn kind(&self) -> &'static str {
        "Render"
    }

    fn version(&self) -> u32 {
        7
    }

    fn check(&self) -> Result<(), StageError> {
        // NaN fails both comparisons, so that it is refused as well.
        if !(self.scale > 0.0 && self.scale <= 64.0) {
            return Err(StageError::parameter(
                "scale",
                format!("is {}; it must be above 0 and at most 64", self.scale),
            ));
        }
        match &self.path {
            Some(CameraPath::Spiral { turns, .. }) if !(*turns > 0.0 && *turns <= 1000.0) => {
                return Err(StageError::parameter(
                    "path.turns",
                    format!("is {turns}; it must be above 0"),
                ));
            }
            Some(CameraPath::Spiral { frames, .. } | CameraPath::Circle { frames }) => {
                convert::in_range("path.frames", *frames, 1, 100_000)?;
            }
            Some(CameraPath::File { .. }) | None => {}
        }
        convert::in_range("supersample", self.supersample, 1, 16)?;
        shard::check(self.shards, self.shard)
    }

    fn sources(&self) -> Result<Vec<Source>, StageError> {
        let Some(CameraPath::File { path }) = &self.path else {
            return Ok(Vec::new());
        };
        Ok(vec![Source {
            name: "poses".into(),
            digest: Digest::new(scene::path_digest(path)?),
        }])
    }

    fn locations(&self) -> &'static [&'static str] {
        &["path.path"]
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![FIELD.input(&self.field), CAMERAS.input(&self.cameras)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![IMAGES.output()]
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| {
            AnyStage::Render(Self {
                shard,
                ..self.clone()
            })
        })
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [(IMAGES.name, self.rendered(inputs))].into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let written = self.rendered(inputs);
        let rays = written.pixels as f64 * f64::from(self.supersample).powi(2);
        // Cameras alone are read of the images.
        let field = inputs.iter().filter(|(name, _)| **name == FIELD.name);
        let field: Sizes = field.map(|(name, size)| (*name, *size)).collect();
        Estimate::streaming(&field, written, RENDERED).computing(64 << 20, rays * RAY_SECONDS)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let field = convert::field(io.read(FIELD)?)?;
        // Cameras alone, since the images' pixels would be read for nothing.
        let cameras = io.images(CAMERAS)?;
        let options = nerf::RenderOptions {
            supersample: self.supersample,
            ..Default::default()
        };
        // Renders of an opaque scene's own views are opaque; a path may lead the camera past what
        // the scene has.
        let alpha = self.path.is_some() || cameras.has_alpha()?;
        // Frames are numbered before they are dealt out, so that names do not depend on the shards.
        let path = self.part().take(self.views(&cameras)?)?;
        // Once for all views: on a GPU the field moves there only once.
        let renderer = nerf::Renderer::new(io.device, &field);
        let mut out = io.image_writer(IMAGES, cameras.bounds, cameras.to_source);
        for (done, (name, camera)) in path.iter().enumerate() {
            let camera = camera.scaled_by(self.scale);
            let rendered = renderer.render(&camera, &options);
            out.add(convert::rendered_view(name, &camera, rendered, alpha))?;
            io.progress(done + 1, path.len(), &[])?;
        }
        Ok(out.finish()?)
    }
}
