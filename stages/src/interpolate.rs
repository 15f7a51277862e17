//! `Interpolate`: enlarges (or reduces) images by a fixed filter or a learned one. Knows nothing of fields.

use std::path::PathBuf;

use artifacts_schema::{ArtifactKind, ImageSet, View};
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use serde::{Deserialize, Serialize};
use upsampler::Upsampler;

use crate::back_projection::back_project;
use crate::convert;
use crate::error::StageError;
use crate::learned::Learned;
use crate::stage::{Estimate, Input, InputPort, Io, OutputPort, Sizes, Source, Stage};

/// Enlarges the images of a set; of transparent ones, what they are before black, and their alpha by itself.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Interpolate {
    /// The images.
    pub images: Input,
    /// The size of the result over the size of the images.
    pub factor: f64,
    /// The filter.
    pub filter: Kernel,
    /// The values that are interpolated; for a learned filter, `Srgb`.
    pub values: Values,
    /// Rounds of back-projection onto the images that are enlarged: each adds the enlarged difference between them and
    /// the reduced result. 0 turns it off.
    pub back_projection: u32,
}

/// An interpolation filter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kernel {
    /// Cubic convolution with a = -0.75, as PyTorch's.
    Bicubic,
    /// Lanczos with three lobes.
    Lanczos,
    /// The nearest pixel.
    Nearest,
    /// A network, at its own factor; what is left to `factor` is bicubic, and so is alpha.
    Learned(Learned),
}

/// The values that are interpolated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Values {
    /// Display-encoded values: what the prior was trained on and what the metrics' bicubic baseline uses; ringing at
    /// bright edges stays as small as the eye sees it.
    Srgb,
    /// Scene-linear light: physically right for averaging, but bright edges ring into the dark.
    Linear,
}

impl Default for Interpolate {
    fn default() -> Self {
        Self {
            images: Input::default(),
            factor: 4.0,
            filter: Kernel::Bicubic,
            values: Values::Srgb,
            back_projection: 0,
        }
    }
}

impl Interpolate {
    fn enlarge(&self, view: &View, network: Option<&Upsampler>, device: &Device) -> View {
        let camera = convert::scaled(&convert::camera(&view.camera), self.factor);
        let filter = match self.filter {
            Kernel::Bicubic | Kernel::Learned(_) => Filter::BicubicTorch,
            Kernel::Lanczos => Filter::Lanczos3,
            Kernel::Nearest => Filter::Nearest,
        };
        let (h, w) = (camera.height as usize, camera.width as usize);
        let enlarged = |image: &Array| resize(image, h, w, filter, true);
        let alpha = convert::alpha_array(view, device).map(|alpha| {
            enlarged(&alpha)
                .to_vec()
                .iter()
                .map(|x| x.clamp(0.0, 1.0))
                .collect::<Vec<_>>()
        });
        let low = match self.values {
            Values::Srgb => convert::srgb_array(view, device),
            Values::Linear => convert::linear_array(view, device),
        };
        let image = match (&self.filter, network) {
            (Kernel::Learned(learned), Some(network)) => learned.resize(network, &low, [h, w]),
            _ => enlarged(&low),
        };
        let rgb = match self.values {
            Values::Srgb => convert::disk_pixels(
                &back_project(image, &low, self.back_projection, [0.0, 1.0]),
                alpha.as_deref(),
            ),
            Values::Linear => convert::pixels(&back_project(
                image,
                &low,
                self.back_projection,
                [f32::MIN, f32::MAX],
            )),
        };
        View {
            name: view.name.clone(),
            camera: convert::disk_camera(&camera),
            rgb,
            alpha,
            depth: None,
            mask: None,
        }
    }

    fn learned(&self) -> Option<&Learned> {
        match &self.filter {
            Kernel::Learned(learned) => Some(learned),
            Kernel::Bicubic | Kernel::Lanczos | Kernel::Nearest => None,
        }
    }
}

impl Stage for Interpolate {
    fn kind(&self) -> &'static str {
        "Interpolate"
    }

    fn version(&self) -> u32 {
        2
    }

    fn check(&self) -> Result<(), StageError> {
        if !(self.factor > 0.0 && self.factor <= 64.0) {
            return Err(StageError::parameter(
                "factor",
                format!("is {}; it must be above 0 and at most 64", self.factor),
            ));
        }
        convert::in_range("back_projection", self.back_projection, 0, 1000)?;
        let Some(learned) = self.learned() else {
            return Ok(());
        };
        if self.values == Values::Linear {
            return Err(StageError::parameter(
                "values",
                "is Linear; a learned filter takes Srgb",
            ));
        }
        learned.check()
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![InputPort::new("images", &self.images, ArtifactKind::Images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![OutputPort {
            name: "images",
            kind: ArtifactKind::Images,
        }]
    }

    fn sources(&self) -> Result<Vec<Source>, StageError> {
        self.learned().map_or(Ok(Vec::new()), Learned::sources)
    }

    fn source_files(&self) -> Option<Vec<PathBuf>> {
        Some(self.learned().map_or(Vec::new(), Learned::files))
    }

    fn locations(&self) -> &'static [&'static str] {
        if self.learned().is_some() {
            &["filter.model"]
        } else {
            &[]
        }
    }

    fn uses_device(&self) -> bool {
        self.learned().is_some()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let Some(learned) = self.learned() else {
            return Estimate::reading(inputs);
        };
        let (memory, seconds) = learned.cost(inputs.values().sum());
        Estimate::reading(inputs).computing(memory, seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images: ImageSet = io.read("images")?;
        let network = self
            .learned()
            .map(|learned| learned.load(io.device))
            .transpose()?;
        let mut views = Vec::new();
        for (done, view) in images.views.iter().enumerate() {
            views.push(self.enlarge(view, network.as_ref(), io.device));
            io.progress(done + 1, images.views.len(), &[])?;
        }
        io.write(
            "images",
            &ImageSet {
                views,
                bounds: images.bounds,
                to_source: images.to_source,
            },
        )
    }
}
