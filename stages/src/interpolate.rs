//! `Interpolate`: enlarges (or reduces) images by a fixed filter. Knows nothing of fields or networks.

use artifacts_schema::{ArtifactKind, ImageSet, View};
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::stage::{Input, InputPort, Io, OutputPort, Stage};

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
    /// The values that are interpolated.
    pub values: Values,
}

/// An interpolation filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kernel {
    /// Cubic convolution with a = -0.75, as PyTorch's.
    Bicubic,
    /// Lanczos with three lobes.
    Lanczos,
    /// The nearest pixel.
    Nearest,
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
        Self { images: Input::default(), factor: 4.0, filter: Kernel::Bicubic, values: Values::Srgb }
    }
}

impl Interpolate {
    fn enlarge(&self, view: &View, device: &Device) -> View {
        let camera = convert::scaled(&convert::camera(&view.camera), self.factor);
        let filter = match self.filter {
            Kernel::Bicubic => Filter::BicubicTorch,
            Kernel::Lanczos => Filter::Lanczos3,
            Kernel::Nearest => Filter::Nearest,
        };
        let (h, w) = (camera.height as usize, camera.width as usize);
        let enlarged = |image: &Array| resize(image, h, w, filter, true);
        let alpha = convert::alpha_array(view, device)
            .map(|alpha| enlarged(&alpha).to_vec().iter().map(|x| x.clamp(0.0, 1.0)).collect::<Vec<_>>());
        let rgb = match self.values {
            Values::Srgb => convert::disk_pixels(&enlarged(&convert::srgb_array(view, device)), alpha.as_deref()),
            Values::Linear => convert::pixels(&enlarged(&convert::linear_array(view, device))),
        };
        View { name: view.name.clone(), camera: convert::disk_camera(&camera), rgb, alpha, depth: None }
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
        Ok(())
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![InputPort::new("images", &self.images, ArtifactKind::Images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![OutputPort { name: "images", kind: ArtifactKind::Images }]
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images: ImageSet = io.read("images")?;
        let mut views = Vec::new();
        for (done, view) in images.views.iter().enumerate() {
            views.push(self.enlarge(view, io.device));
            io.progress(done + 1, images.views.len(), &[])?;
        }
        io.write("images", &ImageSet { views, bounds: images.bounds })
    }
}
