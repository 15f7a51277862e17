//! `Sync`: brings a field in line with enlarged views (I3DS, paper algorithm 2). Knows nothing of
//! how they were enlarged.

use artifacts_schema::ImageSet;
use nerf::TrainOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::photos::Photos;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::size::{Foretold, Sizes, input};
use crate::stage::{Estimate, Extension, Stage};
use crate::training::{self, FIELD, LOG};

const IMAGES: Port<ImageSet> = Port::new("images");
const LOW: Port<ImageSet> = Port::new("low");

/// Trains a field on enlarged views, and on the low-resolution photos so that rounds cannot drift
/// from them.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Sync {
    /// The field.
    pub field: Input,
    /// The enlarged views.
    pub images: Input,
    /// The low-resolution photos, seen as area means of the rendered detail.
    pub low: Input,
    /// How much a low-resolution photo's pixel counts beside an enlarged view's; 0 leaves them out.
    #[schemars(range(min = 0, max = 1000))]
    pub low_weight: f64,
    /// Sub-rays per pixel and axis of a low-resolution photo.
    #[schemars(range(min = 1, max = 16))]
    pub low_supersample: u32,
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
}

impl Default for Sync {
    fn default() -> Self {
        let options = TrainOptions::default();
        Self {
            field: Input::default(),
            images: Input::default(),
            low: Input::default(),
            low_weight: 1.0,
            low_supersample: 2,
            steps: 1000,
            samples: options.samples,
            // Less than `Fit`'s: the field is near where it should be.
            rate: 1e-2,
            final_rate: options.final_rate,
        }
    }
}

impl Sync {
    /// The library's options. Their fields stand in `Sync` as in `Fit`, since serde's `flatten`
    /// cannot refuse unknown fields.
    fn options(&self) -> TrainOptions {
        TrainOptions {
            steps: self.steps,
            samples: self.samples,
            rate: self.rate,
            final_rate: self.final_rate,
            ..TrainOptions::default()
        }
    }
}

impl Stage for Sync {
    fn kind(&self) -> &'static str {
        "Sync"
    }

    fn version(&self) -> u32 {
        9
    }

    fn check(&self) -> Result<(), StageError> {
        convert::number_in_range("low_weight", self.low_weight, 0.0, 1000.0)?;
        convert::in_range("low_supersample", self.low_supersample, 1, 16)?;
        training::check(&self.options())
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            FIELD.input(&self.field),
            IMAGES.input(&self.images),
            LOW.input(&self.low).only_if(self.low_weight > 0.0),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![FIELD.output(), LOG.output()]
    }

    fn extension(&self) -> Extension {
        training::extension(self.final_rate)
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let table = match inputs.get(FIELD.name) {
            Some(field) => field.bytes,
            // That of the default field.
            None => 16 << 20,
        };
        training::estimate(inputs, table, &self.options())
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [(FIELD.name, input(inputs, FIELD.name))].into()
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let field = convert::field(io.read(FIELD)?)?;
        let mut photos = vec![Photos {
            images: io.images(IMAGES)?,
            // The weights of photos are relative to this 1.
            weight: 1.0,
            supersample: 1,
        }];
        if self.low_weight > 0.0 {
            photos.push(Photos {
                images: io.images(LOW)?,
                weight: self.low_weight as f32,
                supersample: self.low_supersample,
            });
        }
        training::train(field, &photos, &self.options(), io).map(drop)
    }
}
