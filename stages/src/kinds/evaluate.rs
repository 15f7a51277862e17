//! `Evaluate`: held-out views against the truth, for the field and for its baselines. Knows nothing
//! of how they came about.

mod consistency;
mod masked;
mod networks;
mod pictures;
mod scores;

use std::collections::BTreeMap;
use std::path::PathBuf;

use artifacts_schema::{Figures, ImageSet, Metrics, View};
use compute::resize::{Filter, resize};
use formats::pixels::planes;
use nerf::{Field, Rendered};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::consistency::{Shown, warped};
use self::networks::Networks;
use self::pictures::{BEHIND, Picked, error_map, side_by_side};
use self::scores::Scores;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::stage::{Estimate, Sizes, Source, Stage};

const FIELD: Port<artifacts_schema::Field> = Port::new("field");
const BASELINE: Port<artifacts_schema::Field> = Port::new("baseline");
const TRUTH: Port<ImageSet> = Port::new("truth");
const LOW: Port<ImageSet> = Port::new("low");
const TRAIN: Port<ImageSet> = Port::new("train");

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
        }
    }
}

/// The one column that is only this stage's.
const OWN: (&str, &str) = (
    "psnr_lr",
    "PSNR in dB against the low-resolution photos that the field was trained on; higher is better",
);

/// The rows of the fields, and that of an enlarged render.
const SR: &str = "sr_nerf";
const LR: &str = "lr_nerf";
const BICUBIC: &str = "bicubic";

impl Evaluate {
    fn render(&self, field: &Field, view: &View) -> Rendered {
        // A truth with alpha is put before white (`Picked::of`), so the field must be too.
        let background = if view.pixels.alpha.is_some() {
            [BEHIND; 3]
        } else {
            [0.0; 3]
        };
        let options = nerf::RenderOptions {
            supersample: self.supersample,
            background,
        };
        // On the CPU whatever the device, so that figures of fields from different devices compare.
        nerf::render(field, &view.camera, &options)
    }

    /// The field from all held-out cameras.
    fn show(
        &self,
        field: &Field,
        truths: &ImageSet,
        tell: &mut dyn FnMut() -> Result<(), StageError>,
    ) -> Result<Vec<Shown>, StageError> {
        let mut shown = Vec::new();
        for view in &truths.views {
            shown.push(Shown {
                camera: view.camera,
                image: self.render(field, view),
            });
            tell()?;
        }
        Ok(shown)
    }

    /// The field at low resolution, enlarged to the size of `truth` on sRGB values.
    fn bicubic(&self, field: &Field, low: &View, truth: &View, io: &Io) -> Picked {
        let small = self.render(field, low);
        let shape = [1, 3, small.height as usize, small.width as usize];
        let array = io.device.array(&shape, planes(&small.rgb, 3));
        let height = truth.camera.height as usize;
        let width = truth.camera.width as usize;
        // Enlarged from what the field shows, not from the photo: the baseline knows the scene as
        // the field does.
        let rgb = convert::pixels(&resize(&array, height, width, Filter::BicubicTorch, false));
        Picked {
            width,
            height,
            // Bicubic overshoots at edges.
            rgb: rgb.iter().map(|x| x.clamp(0.0, 1.0)).collect(),
        }
    }
}

/// A render as a picture.
fn picked(image: &Rendered) -> Picked {
    Picked {
        width: image.width as usize,
        height: image.height as usize,
        rgb: image.rgb.clone(),
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
        6
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
        Estimate::reading(inputs).computing(64 << 20, 30.0)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        // Before anything is rendered: the files may have changed since the run was planned.
        let networks = Networks::open(&self.lpips)?;
        let field = convert::field(io.read(FIELD)?)?;
        let baseline = convert::field(io.read(BASELINE)?)?;
        let truths = io.read(TRUTH)?;
        let lows = io.read(LOW)?;
        let train = io.read(TRAIN)?;
        // Each held-out view is rendered by two fields and then measured.
        let steps = 3 * truths.views.len() + train.views.len();
        let mut done = 0;
        let mut tell = || {
            done += 1;
            io.progress(done, steps, &[])
        };
        let fields = [
            (SR, self.show(&field, &truths, &mut tell)?),
            (LR, self.show(&baseline, &truths, &mut tell)?),
        ];
        let mut scores = Scores::default();
        // In the order of the outputs below.
        let mut sets: [BTreeMap<_, _>; 4] = Default::default();
        for (at, view) in truths.views.iter().enumerate() {
            let low = convert::view_named(&lows, &view.name)?;
            let truth = Picked::of(view);
            let mask = view.mask.as_deref();
            // Masked pixels take the truth's values, so that every metric finds no error there.
            let enlarged = self
                .bicubic(&baseline, low, view, io)
                .masked_by(&truth, mask);
            let render = |field: usize| picked(&fields[field].1[at].image).masked_by(&truth, mask);
            let [sr, lr] = [0, 1].map(render);
            let low = Picked::of(low);
            let images = [(BICUBIC, &enlarged), (LR, &lr), (SR, &sr)];
            for (row, image) in images {
                let mut measured = scores.measure(image.image(), truth.image(), low.image());
                measured.extend(networks.measure(truth.image(), image.image()));
                if self.exposed {
                    let exposed = image.exposed_as(&truth, mask).masked_by(&truth, mask);
                    let psnr = metrics::psnr(truth.image(), exposed.image());
                    measured.push(("psnr_hr_exposed", Ok(psnr)));
                }
                scores.add(row, &view.name, masked::counted(measured, mask));
            }
            for (row, shown) in &fields {
                scores.add(row, &view.name, warped(shown, at));
            }
            let no_depth = || Err("an enlarged picture has no depth".to_owned());
            // Said and not left out, so that an empty place in the table has its reason.
            scores.add(BICUBIC, &view.name, [("psnr_warped", no_depth())]);
            let mut put = |set: usize, picture| sets[set].insert(view.name.clone(), picture);
            // Comparisons are large, and the first few views tell as much as all.
            if at < self.figures as usize {
                put(0, side_by_side(&truth, &images));
            }
            put(1, sr.picture());
            put(2, truth.picture());
            put(3, error_map(&truth, &sr));
            tell()?;
        }
        for view in &train.views {
            let truth = Picked::of(view);
            let mask = view.mask.as_deref();
            let render = picked(&self.render(&baseline, view)).masked_by(&truth, mask);
            let psnr = metrics::psnr(truth.image(), render.image());
            let measured = masked::counted(vec![(OWN.0, Ok(psnr))], mask);
            scores.add("lr_nerf_on_training_views", &view.name, measured);
            tell()?;
        }
        if let Some(warning) = scores.warning() {
            io.warn(warning);
        }
        io.write(METRICS, &scores.finish(&[OWN]))?;
        for (port, images) in [FIGURES, RENDERS, PHOTOS, FLIP].into_iter().zip(sets) {
            io.write(port, &Figures { images })?;
        }
        Ok(())
    }
}
