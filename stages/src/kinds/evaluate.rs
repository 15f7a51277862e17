//! `Evaluate`: held-out views against the truth, for the field and for its baselines. Knows nothing
//! of how they came about.

mod album;
mod consistency;
mod evaluation;
mod masked;
mod networks;
mod pictures;
mod renders;
mod scores;

use std::path::PathBuf;

use artifacts_schema::{Figures, ImageSet, Metrics};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::evaluation::Evaluation;
use self::networks::Networks;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::size::{Size, Sizes, input};
use crate::stage::{Estimate, RAY_SECONDS, Source, Stage};

const FIELD: Port<artifacts_schema::Field> = Port::new("field");
const BASELINE: Port<artifacts_schema::Field> = Port::new("baseline");
const TRUTH: Port<ImageSet> = Port::new("truth");
const LOW: Port<ImageSet> = Port::new("low");
const TRAIN: Port<ImageSet> = Port::new("train");

/// Bytes of a pixel while it is measured, of a few renders and pictures of it among them.
const WORKED: u64 = 400;
/// Seconds of two cores for a pixel that is measured.
const MEASURED: f64 = 1e-5;

const METRICS: Port<Metrics> = Port::new("metrics");
/// Truth and rows side by side.
const FIGURES: Port<Figures> = Port::new("figures");
/// The field as each held-out camera sees it.
const RENDERS: Port<Figures> = Port::new("renders");
/// What the camera saw.
const PHOTOS: Port<Figures> = Port::new("photos");
/// What FLIP sees between the two.
const FLIP: Port<Figures> = Port::new("flip");

/// Measures a field on views that no other stage saw, beside two baselines of the low-resolution
/// field.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Evaluate {
    /// The super-resolved field: row `sr_nerf`.
    pub field: Input,
    /// The low-resolution field: rendered at high resolution (row `lr_nerf`), and at low resolution
    /// and then enlarged (row `bicubic`).
    pub baseline: Input,
    /// The held-out photos at high resolution.
    pub truth: Input,
    /// The held-out photos at low resolution.
    pub low: Input,
    /// The low-resolution training photos: row `lr_nerf_on_training_views`.
    pub train: Input,
    /// Rays per pixel and axis.
    #[schemars(range(min = 1, max = 16))]
    pub supersample: u32,
    /// For how many views to draw a comparison.
    #[schemars(range(min = 0, max = 1000))]
    pub figures: u32,
    /// Weights of LPIPS or ST-LPIPS networks, trunk and heads in one `.safetensors` file: a column
    /// for each.
    pub lpips: Vec<PathBuf>,
    /// Also measure every image at the exposure of its photo (`psnr_hr_exposed`): for photos whose
    /// exposures differ, of which a held-out one has its own that no field can know.
    pub exposed: bool,
    /// Also measure the fields from where they show each photo best (`psnr_hr_posed`): for fields
    /// whose poses were refined, and for held-out poses that are off. Takes seconds a view, on the
    /// CPU.
    pub posed: bool,
}

impl Default for Evaluate {
    fn default() -> Self {
        let none = Input::default;
        Self {
            field: none(),
            baseline: none(),
            truth: none(),
            low: none(),
            train: none(),
            supersample: 2,
            figures: 3,
            lpips: Vec::new(),
            exposed: false,
            posed: false,
        }
    }
}

/// Where a metric stands among others in a table: the most telling first, what is not known here
/// last.
pub fn metric_rank(name: &str) -> usize {
    let known = metrics::DEFINITIONS.iter();
    let mut names = known.map(|(known, _)| *known);
    names.position(|known| known == name).unwrap_or(usize::MAX)
}

impl Stage for Evaluate {
    fn kind(&self) -> &'static str {
        "Evaluate"
    }

    fn version(&self) -> u32 {
        8
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("supersample", self.supersample, 1, 16)?;
        convert::in_range("figures", self.figures, 0, 1000)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            FIELD.input(&self.field),
            BASELINE.input(&self.baseline),
            TRUTH.input(&self.truth),
            LOW.input(&self.low),
            TRAIN.input(&self.train),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        let mut ports = vec![METRICS.output()];
        ports.extend([FIGURES, RENDERS, PHOTOS, FLIP].map(Port::output));
        ports
    }

    fn locations(&self) -> &'static [&'static str] {
        if self.lpips.is_empty() {
            &[]
        } else {
            &["lpips"]
        }
    }

    fn sources(&self) -> Result<Vec<Source>, StageError> {
        networks::sources(&self.lpips)
    }

    fn source_files(&self) -> Option<Vec<PathBuf>> {
        Some(self.lpips.clone())
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let truth = input(inputs, TRUTH.name);
        let train = input(inputs, TRAIN.name);
        let rays = (2 * truth.pixels + train.pixels) as f64 * f64::from(self.supersample).powi(2);
        let posed = if self.posed { 60.0 } else { 0.0 };
        let measured = truth.pixels as f64 * MEASURED;
        Estimate::streaming(inputs, Size::default(), 0).computing(
            WORKED * truth.largest,
            posed + measured + rays * RAY_SECONDS,
        )
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        // Before anything is rendered: the files may have changed since the run was planned.
        let networks = Networks::open(&self.lpips)?;
        let fields = [io.read(FIELD)?, io.read(BASELINE)?];
        let [field, baseline] = fields.map(convert::field);
        let truths = io.images(TRUTH)?;
        let lows = io.images(LOW)?;
        let train = io.images(TRAIN)?;
        let mut evaluation = Evaluation::new(self, io, networks, [field?, baseline?])?;
        // Each held-out view is rendered by two fields and then measured.
        evaluation.expect(3 * truths.cameras().len() + train.cameras().len());
        evaluation.show(&truths)?;
        for view in truths.views() {
            let view = view?;
            evaluation.held_out(&view, &convert::view_named(&lows, &view.name)?)?;
        }
        for view in train.views() {
            evaluation.training(&view?)?;
        }
        io.write(METRICS, &evaluation.finish()?)
    }
}
