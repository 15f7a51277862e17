//! `Interpolate`: enlarges (or reduces) images by a fixed filter or a learned one. Knows nothing of
//! fields.

mod learned;
#[cfg(test)]
mod tests;

use artifacts_schema::{ImageSet, View};
use compute::elementwise::clamp;
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use formats::Pixels;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use upsampler::Upsampler;

use self::learned::Learned;
use crate::back_projection::back_project;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::masks;
use crate::model::Model;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Estimate, Stage};

/// The images that are enlarged, and those that come out.
const IMAGES: Port<ImageSet> = Port::new("images");

/// Bytes of an enlarged pixel while it is worked on: a few arrays of its colours.
const WORKED: u64 = 120;

/// Enlarges the images of a set; of transparent ones, what they are before black, and their alpha
/// by itself.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Interpolate {
    /// The images.
    pub images: Input,
    /// The size of the result over the size of the images.
    #[schemars(range(max = 64), extend("exclusiveMinimum" = 0))]
    pub factor: f64,
    /// The filter.
    pub filter: Kernel,
    /// The values that are interpolated; for a learned filter, `Srgb`.
    pub values: Values,
    /// Rounds of back-projection onto the images that are enlarged: each adds the enlarged
    /// difference between them and the reduced result. 0 turns it off.
    #[schemars(range(min = 0, max = 1000))]
    pub back_projection: u32,
    /// In how many parts the views are enlarged, each a stage of its own; the images are the same
    /// for any number.
    #[schemars(range(min = 1))]
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

/// An interpolation filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Kernel {
    /// Cubic convolution with a = -0.75, as PyTorch's.
    Bicubic,
    /// Lanczos with three lobes.
    Lanczos,
    /// The nearest pixel.
    Nearest,
    /// A network, at its own factor; what is left to `factor` is bicubic. Alpha goes through it as
    /// a grey picture.
    Learned(Learned),
}

/// The values that are interpolated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Values {
    /// Display-encoded values: what the prior was trained on and what the metrics' bicubic baseline
    /// uses; ringing at bright edges stays as small as the eye sees it.
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
            shards: 1,
            shard: 0,
        }
    }
}

impl Interpolate {
    fn enlarge(&self, view: &View, network: Option<&Upsampler>, device: &Device) -> View {
        let camera = view.camera.scaled_by(self.factor);
        let size = [camera.height as usize, camera.width as usize];
        let alpha = convert::alpha_array(view, device)
            .map(|alpha| self.alpha(&alpha, size, network).to_vec());
        // [1, 3, h, w]: what a photo masks must not be projected back.
        let counts = masks::factors(view, 3, device);
        let pixels = match self.values {
            Values::Srgb => {
                let low = convert::srgb_array(view, device);
                let large = self.resized(&low, size, network);
                let large = back_project(
                    large,
                    &low,
                    counts.as_ref(),
                    self.back_projection,
                    [0.0, 1.0],
                );
                convert::disk_pixels(&large, alpha)
            }
            Values::Linear => {
                let low = convert::linear_array(view, device);
                let large = self.resized(&low, size, network);
                // Light has no upper end, and bicubic may undershoot.
                let any = [f32::MIN, f32::MAX];
                let large = back_project(large, &low, counts.as_ref(), self.back_projection, any);
                Pixels::new(convert::pixels(&large), alpha)
            }
        };
        View {
            name: view.name.clone(),
            camera,
            pixels,
            depth: None,
            mask: masks::at_size(view, camera.width, camera.height),
        }
    }

    /// `image [1, 3, h, w]` at another size [H, W].
    fn resized(&self, image: &Array, size: [usize; 2], network: Option<&Upsampler>) -> Array {
        match (&self.filter, network) {
            (Kernel::Learned(learned), Some(network)) => learned.resize(network, image, size),
            _ => self.filtered(image, size),
        }
    }

    /// `image [1, C, h, w]` at another size [H, W], by a fixed filter. `Kernel` is no [`Filter`]:
    /// of those it has only the ones that a pipeline may name.
    fn filtered(&self, image: &Array, [height, width]: [usize; 2]) -> Array {
        let filter = match self.filter {
            Kernel::Bicubic | Kernel::Learned(_) => Filter::BicubicTorch,
            Kernel::Lanczos => Filter::Lanczos3,
            Kernel::Nearest => Filter::Nearest,
        };
        resize(image, height, width, filter, true)
    }

    /// `alpha [1, 1, h, w]` at another size. To a network it is a grey picture: an outline as soft
    /// as bicubic's would show as a rim around an object whose colours are sharp.
    fn alpha(&self, alpha: &Array, size: [usize; 2], network: Option<&Upsampler>) -> Array {
        let values = alpha.to_vec();
        // What is opaque, or transparent, all over stays so to the last digit.
        if values.iter().all(|value| *value == values[0]) {
            return alpha.device().full(&[1, 1, size[0], size[1]], values[0]);
        }
        // Bicubic overshoots, and a coverage must not.
        if network.is_none() {
            return clamp(&self.filtered(alpha, size), 0.0, 1.0);
        }
        let small = [1, 3, alpha.shape()[2], alpha.shape()[3]];
        let grey = alpha.device().array(&small, values.repeat(3));
        let large = self.resized(&grey, size, network);
        let mean = large.to_vec();
        let plane = size[0] * size[1];
        // A network need not keep grey grey.
        let mean = (0..plane)
            .map(|i| (mean[i] + mean[plane + i] + mean[2 * plane + i]) / 3.0)
            .collect();
        let large = alpha.device().array(&[1, 1, size[0], size[1]], mean);
        back_project(large, alpha, None, self.back_projection, [0.0, 1.0])
    }

    fn enlarged(&self, inputs: &Sizes) -> Size {
        let own = self.part().size(input(inputs, IMAGES.name));
        own.scaled(self.factor)
    }

    fn part(&self) -> Shard {
        Shard::new(self.shards, self.shard)
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
        4
    }

    fn check(&self) -> Result<(), StageError> {
        // NaN fails both comparisons, so that it is refused as well.
        if !(self.factor > 0.0 && self.factor <= 64.0) {
            return Err(StageError::parameter(
                "factor",
                format!("is {}; it must be above 0 and at most 64", self.factor),
            ));
        }
        convert::in_range("back_projection", self.back_projection, 0, 1000)?;
        shard::check(self.shards, self.shard)?;
        let Some(learned) = self.learned() else {
            return Ok(());
        };
        // Networks were trained on display-encoded values.
        if self.values == Values::Linear {
            return Err(StageError::parameter(
                "values",
                "is Linear; a learned filter takes Srgb",
            ));
        }
        learned.check()
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![IMAGES.input(&self.images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![IMAGES.output()]
    }

    fn model(&self) -> Option<&dyn Model> {
        self.learned().map(|learned| learned as &dyn Model)
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| {
            AnyStage::Interpolate(Self {
                shard,
                ..self.clone()
            })
        })
    }

    fn uses_device(&self) -> bool {
        self.learned().is_some()
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [(IMAGES.name, self.enlarged(inputs))].into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let written = self.enlarged(inputs);
        let inputs = &self.part().sizes(inputs);
        let estimate = Estimate::streaming(inputs, written, WORKED);
        let Some(learned) = self.learned() else {
            return estimate;
        };
        let (memory, seconds) = learned.cost(input(inputs, IMAGES.name).pixels);
        estimate.computing(memory, seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images = self.part().images(io.images(IMAGES)?)?;
        let count = images.cameras().len();
        let network = self
            .learned()
            .map(|learned| learned.load(io.device))
            .transpose()?;
        let mut out = io.image_writer(IMAGES, images.bounds, images.to_source);
        for (done, view) in images.views().enumerate() {
            out.add(self.enlarge(&view?, network.as_ref(), io.device))?;
            io.progress(done + 1, count, &[])?;
        }
        Ok(out.finish()?)
    }
}
