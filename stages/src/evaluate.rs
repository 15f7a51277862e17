//! `Evaluate`: held-out views against the truth, for the field and for its baselines. Knows nothing
//! of how they came about.

use std::collections::BTreeMap;

use artifacts_schema::{ArtifactKind, Figures, ImageSet, Metrics, Picture, Row, View};
use compute::resize::{Filter, resize};
use metrics::{Image, Panel};
use nerf::Field;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::masked;
use crate::stage::{Estimate, Input, InputPort, Io, OutputPort, Sizes, Stage};

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
        }
    }
}

/// What is behind a truth with alpha, and behind the fields that are measured against it: white, as
/// NeRF-synthetic has it.
const BEHIND: f32 = 1.0;

/// An image in sRGB-encoded values, interleaved.
struct Picked {
    width: usize,
    height: usize,
    rgb: Vec<f32>,
}

impl Picked {
    fn of(view: &View) -> Self {
        Self {
            width: view.camera.width as usize,
            height: view.camera.height as usize,
            rgb: convert::srgb_before(view, BEHIND),
        }
    }

    /// The image with the truth's own pixels where the truth is masked, so that these do not count.
    fn masked_by(mut self, truth: &Picked, mask: Option<&[bool]>) -> Self {
        for (i, _) in mask
            .into_iter()
            .flatten()
            .enumerate()
            .filter(|(_, counts)| !**counts)
        {
            let pixel = 3 * i..3 * i + 3;
            self.rgb[pixel.clone()].copy_from_slice(&truth.rgb[pixel]);
        }
        self
    }

    fn image(&self) -> Image<'_> {
        Image::new(self.width, self.height, &self.rgb)
    }
}

impl Evaluate {
    fn render(&self, field: &Field, view: &View) -> Picked {
        let background = if view.alpha.is_some() {
            [BEHIND; 3]
        } else {
            [0.0; 3]
        };
        let options = nerf::RenderOptions {
            supersample: self.supersample,
            background,
        };
        let image = nerf::render(field, &convert::camera(&view.camera), &options);
        Picked {
            width: image.width as usize,
            height: image.height as usize,
            rgb: image.rgb,
        }
    }

    /// The field at low resolution, enlarged to the size of `truth` on sRGB values.
    fn bicubic(&self, field: &Field, low: &View, truth: &View, io: &Io) -> Picked {
        let small = self.render(field, low);
        let planes = (0..3)
            .flat_map(|c| small.rgb.iter().skip(c).step_by(3).copied())
            .collect();
        let array = io.device.array(&[1, 3, small.height, small.width], planes);
        let height = truth.camera.height as usize;
        let width = truth.camera.width as usize;
        let rgb = convert::pixels(&resize(&array, height, width, Filter::BicubicTorch, false));
        Picked {
            width,
            height,
            rgb: rgb.iter().map(|x| x.clamp(0.0, 1.0)).collect(),
        }
    }
}

/// Truth and images side by side, each with its PSNR.
fn figure(truth: &Picked, images: &[(&str, Picked)]) -> Picture {
    let psnr = |image: &Picked| format!("{:.2} dB", metrics::psnr(truth.image(), image.image()));
    let texts: Vec<_> = images
        .iter()
        .map(|(name, image)| (name.replace('_', " "), psnr(image)))
        .collect();
    let mut panels = vec![Panel {
        label: "truth",
        note: "",
        image: truth.image(),
    }];
    for ((label, note), (_, image)) in texts.iter().zip(images) {
        panels.push(Panel {
            label,
            note,
            image: image.image(),
        });
    }
    let figure = metrics::comparison(&panels);
    Picture {
        width: figure.width as u32,
        height: figure.height as u32,
        rgb8: figure.rgb8,
        legend: BTreeMap::new(),
    }
}

/// Rows of a table: by name, then by view, then by metric.
type Rows = BTreeMap<String, BTreeMap<String, BTreeMap<String, f64>>>;

fn add(rows: &mut Rows, name: &str, view: &View, values: BTreeMap<String, f64>) {
    rows.entry(name.to_owned())
        .or_default()
        .insert(view.name.clone(), values);
}

/// The figures of one image against the truth.
fn measure(image: &Picked, truth: &Picked, low: &Picked) -> BTreeMap<String, f64> {
    let image = image.image();
    let truth = truth.image();
    let low = low.image();
    let values = [
        ("psnr_hr", Some(metrics::psnr(truth, image))),
        ("ssim_hr", metrics::ssim(truth, image)),
        ("niqe_y", metrics::niqe(image).map(|niqe| niqe.value)),
        (
            "psnr_lr_consistency",
            Some(metrics::psnr_lr_consistency(image, low)),
        ),
    ];
    values
        .into_iter()
        .filter_map(|(name, value)| Some((name.to_owned(), value?)))
        .collect()
}

/// What the columns that occur mean.
fn definitions(rows: &BTreeMap<String, Row>) -> BTreeMap<String, String> {
    let ours = (
        "psnr_lr",
        "PSNR in dB against the low-resolution photos that the field was trained on; higher is better",
    );
    let occurs = |name: &str| rows.values().any(|row| row.mean.contains_key(name));
    let known = metrics::DEFINITIONS
        .iter()
        .chain([&ours])
        .filter(|(name, _)| occurs(name));
    known
        .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
        .collect()
}

/// Adds the means over views to a row.
fn row(views: BTreeMap<String, BTreeMap<String, f64>>) -> Row {
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for (name, value) in views.values().flatten() {
        let (sum, count) = sums.entry(name.clone()).or_default();
        (*sum, *count) = (*sum + value, *count + 1.0);
    }
    Row {
        mean: sums
            .into_iter()
            .map(|(name, (sum, count))| (name, sum / count))
            .collect(),
        views,
    }
}

impl Stage for Evaluate {
    fn kind(&self) -> &'static str {
        "Evaluate"
    }

    fn version(&self) -> u32 {
        2
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("supersample", self.supersample, 1, 16)?;
        convert::in_range("figures", self.figures, 0, 1000)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            InputPort::new("field", &self.field, ArtifactKind::Field),
            InputPort::new("baseline", &self.baseline, ArtifactKind::Field),
            InputPort::new("truth", &self.truth, ArtifactKind::Images),
            InputPort::new("low", &self.low, ArtifactKind::Images),
            InputPort::new("train", &self.train, ArtifactKind::Images),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![
            OutputPort {
                name: "metrics",
                kind: ArtifactKind::Metrics,
            },
            OutputPort {
                name: "figures",
                kind: ArtifactKind::Figures,
            },
        ]
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        Estimate::reading(inputs).computing(64 << 20, 30.0)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let (field, baseline) = (
            convert::field(io.read("field")?)?,
            convert::field(io.read("baseline")?)?,
        );
        let truths: ImageSet = io.read("truth")?;
        let lows: ImageSet = io.read("low")?;
        let train: ImageSet = io.read("train")?;
        let mut rows = Rows::new();
        let mut figures = Figures {
            images: BTreeMap::new(),
        };
        for (done, view) in truths.views.iter().enumerate() {
            let low = convert::view_named(&lows, &view.name)?;
            let truth = Picked::of(view);
            let mask = view.mask.as_deref();
            let images = [
                ("bicubic", self.bicubic(&baseline, low, view, io)),
                ("lr_nerf", self.render(&baseline, view)),
                ("sr_nerf", self.render(&field, view)),
            ]
            .map(|(name, image)| (name, image.masked_by(&truth, mask)));
            for (name, image) in &images {
                add(
                    &mut rows,
                    name,
                    view,
                    masked::counted(measure(image, &truth, &Picked::of(low)), mask),
                );
            }
            if done < self.figures as usize {
                figures
                    .images
                    .insert(view.name.clone(), figure(&truth, &images));
            }
            io.progress(done + 1, truths.views.len(), &[])?;
        }
        for view in &train.views {
            let truth = Picked::of(view);
            let mask = view.mask.as_deref();
            let image = self.render(&baseline, view).masked_by(&truth, mask);
            let psnr = metrics::psnr(truth.image(), image.image());
            let values = BTreeMap::from([("psnr_lr".to_owned(), psnr)]);
            add(
                &mut rows,
                "lr_nerf_on_training_views",
                view,
                masked::counted(values, mask),
            );
        }
        let rows: BTreeMap<_, _> = rows
            .into_iter()
            .map(|(name, views)| (name, row(views)))
            .collect();
        io.write(
            "metrics",
            &Metrics {
                definitions: definitions(&rows),
                rows,
            },
        )?;
        io.write("figures", &figures)
    }
}
