//! `Fit`: a radiance field from posed photos. Knows nothing of diffusion.

mod corrected;

use artifacts_schema::{ImageSet, Log};
use nerf::{ExposureOptions, Field, FieldConfig, PoseOptions, Space, SpaceKind, TrainOptions};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::photos::Photos;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Estimate, Extension, Stage};
use crate::training::{self, FIELD, LOG};

const IMAGES: Port<ImageSet> = Port::new("images");
const PHOTOS: Port<ImageSet> = Port::new("photos");
const EXPOSURES: Port<Log> = Port::new("exposures");

/// Fits a hash-grid field to posed photos.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Fit {
    /// The photos.
    pub images: Input,
    /// Training steps.
    #[schemars(range(min = 1, max = 10_000_000))]
    pub steps: u32,
    /// Samples along rays per step.
    #[schemars(range(min = 256, max = 16_777_216))]
    pub samples: u32,
    /// Learning rate at its highest.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// Learning rate of the last step, as a part of `rate`; it falls over the second half of the
    /// steps. At 1 it does not fall, and a finished result can be extended.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub final_rate: f64,
    /// Sub-rays per pixel and axis: a pixel is the mean over its area.
    #[schemars(range(min = 1, max = 16))]
    pub supersample: u32,
    /// How the field's space follows from the scene. `Auto` takes a perspective for what is
    /// photographed from one side.
    pub space: SpaceKind,
    /// The shape of the field.
    pub field: FieldConfig,
    /// Learn how each photo was exposed: `exposure: ()`. For photos of several cameras, or of one
    /// that chose its exposure and white balance anew for each. Then it computes on the CPU.
    pub exposure: Option<ExposureOptions>,
    /// Refine where each photo was taken from: `poses: ()`. For poses that are off by up to some
    /// hundredths, in radians and in parts of the distance to what is seen. Then it computes on the
    /// CPU.
    pub poses: Option<PoseOptions>,
}

impl Default for Fit {
    fn default() -> Self {
        let options = TrainOptions::default();
        Self {
            images: Input::default(),
            steps: 2000,
            samples: options.samples,
            rate: options.rate,
            final_rate: options.final_rate,
            supersample: 2,
            space: SpaceKind::Auto,
            field: FieldConfig::default(),
            exposure: None,
            poses: None,
        }
    }
}

impl Fit {
    /// The library's options. Their fields stand in `Fit` as in `Sync`, since serde's `flatten`
    /// cannot refuse unknown fields.
    fn options(&self) -> TrainOptions {
        TrainOptions {
            steps: self.steps,
            samples: self.samples,
            rate: self.rate,
            final_rate: self.final_rate,
            exposure: self.exposure.clone(),
            poses: self.poses.clone(),
            ..TrainOptions::default()
        }
    }

    /// Bytes of the field's tables, at most.
    fn table_bytes(&self) -> u64 {
        // Two features of four bytes an entry.
        8 * (u64::from(self.field.levels) << self.field.log2_table)
    }

    fn corrects_photos(&self) -> bool {
        self.exposure.is_some() || self.poses.is_some()
    }
}

impl Stage for Fit {
    fn kind(&self) -> &'static str {
        "Fit"
    }

    fn version(&self) -> u32 {
        9
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("supersample", self.supersample, 1, 16)?;
        training::check(&self.options())?;
        if let Some(exposure) = &self.exposure {
            training::check_rate("exposure.rate", exposure.rate)?;
            if !(exposure.pull >= 0.0 && exposure.pull <= 1000.0) {
                let problem = format!("is {}; it must be 0 to 1000", exposure.pull);
                return Err(StageError::parameter("exposure.pull", problem));
            }
        }
        if let Some(poses) = &self.poses {
            training::check_rate("poses.rate", poses.rate)?;
        }
        self.field
            .check()
            .map_err(|problem| StageError::parameter("field", problem))
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![IMAGES.input(&self.images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        let mut ports = vec![FIELD.output(), LOG.output()];
        if self.corrects_photos() {
            ports.push(PHOTOS.output());
        }
        if self.exposure.is_some() {
            ports.push(EXPOSURES.output());
        }
        ports
    }

    fn extension(&self) -> Extension {
        match self.poses {
            Some(_) => Extension::Impossible(
                "steps",
                "the rate at which `poses` moves cameras falls over all steps",
            ),
            None => training::extension(self.final_rate),
        }
    }

    fn uses_device(&self) -> bool {
        // The GPU's kernels have no gradients to poses and exposures.
        !self.corrects_photos()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        training::estimate(inputs, self.table_bytes(), &self.options())
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [
            (FIELD.name, Size::of_bytes(self.table_bytes())),
            (PHOTOS.name, input(inputs, IMAGES.name)),
        ]
        .into()
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let photos = [Photos {
            images: io.images(IMAGES)?,
            weight: 1.0,
            supersample: self.supersample,
        }];
        let [Photos { images, .. }] = &photos;
        let bounds = images.bounds.map(|corner| corner.map(|x| x as f32));
        let cameras: Vec<_> = images.cameras().iter().map(|(_, camera)| camera).collect();
        let space = Space::of(self.space, bounds, &cameras).ok_or_else(|| {
            StageError::parameter(
                "space",
                "is Perspective, but the cameras do not look the same way",
            )
        })?;
        // `Auto` settings become numbers here: the field's file must not depend on cameras that it
        // does not hold.
        let config = self.field.for_cameras(&space, &cameras);
        let field = Field::in_space(&config, space, io.seed);
        // Writes the field and the log; what follows is written only where photos were corrected.
        let trained = training::train(field, &photos, &self.options(), io)?;
        if self.corrects_photos() {
            io.metric(
                "largest shift of a camera, in parts of its distance",
                corrected::largest_shift(images.cameras(), &trained.cameras),
            );
            let mut out = io.image_writer(PHOTOS, images.bounds, images.to_source);
            for (at, view) in images.views().enumerate() {
                out.add(corrected::photo(view?, at, &trained))?;
            }
            out.finish()?;
        }
        if let Some(exposures) = &trained.exposures {
            io.write(
                EXPOSURES,
                &corrected::exposures(images.cameras(), exposures),
            )?;
        }
        Ok(())
    }
}
