//! `Blend`: one image of a network's enlargement and a field's render, by adding up their detail.
//! Knows nothing of how either was made.

mod shares;
#[cfg(test)]
mod tests;
mod views;

use artifacts_schema::View;
use compute::elementwise::{scaled_sum, sub};
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::shares::{Moments, Shares};
use self::views::{IMAGES, LOW, OWN, Sets, Views};
use crate::back_projection::back_project;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::masks;
use crate::port::{Input, InputPort, OutputPort};
use crate::size::{Foretold, Sizes, input};
use crate::stage::{Estimate, Stage};

/// Bytes of a pixel while it is worked on: base, both details and what projection makes of them.
const WORKED: u64 = 140;
/// Seconds of two cores for a pixel.
const PIXEL_SECONDS: f64 = 1e-6;

/// Adds up the detail that an enlargement and a render of the same view have beyond the
/// low-resolution photo.
///
/// The network has its detail from other pictures, the field from the other photos: their errors
/// have little in common. A mean of the two would halve what only one of them knows. The result is
/// the sum of both, in the shares that leave the least squared error; they follow from the images
/// themselves.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Blend {
    /// The enlarged photos. Where they have alpha, so has the result.
    pub images: Input,
    /// The field's renders of the same views at the same size.
    pub own: Input,
    /// The low-resolution photos.
    pub low: Input,
    /// By how much there is more detail than the field shows, where it shows some: a field is less
    /// sharp than what it knows. 1 would be an estimate without bias.
    #[schemars(range(min = 0, max = 10))]
    pub own_gain: f64,
    /// Rounds of back-projection onto the low-resolution photos, of both images and of the result.
    #[schemars(range(min = 0, max = 1000))]
    pub back_projection: u32,
}

impl Default for Blend {
    /// The truth says 1.0 on fern and 1.4 on the still life. In `i3ds.ron`, which sharpens the sum,
    /// 1.15 has the highest PSNR on both; without that, fern wants 1.05 (`docs/results.md`). Each
    /// round applies the gain again, so that a large one ends in noise.
    fn default() -> Self {
        let none = Input::default;
        Self {
            images: none(),
            own: none(),
            low: none(),
            own_gain: 1.15,
            back_projection: 3,
        }
    }
}

/// What an image has beyond the enlarged photo, of network and field; `[1, C, H, W]` each.
struct Detail {
    base: Array,
    images: Array,
    own: Array,
}

/// A low-resolution photo's values, `[1, C, h, w]`, and which of them count, as factors; `None`
/// where all do.
struct Low {
    values: Array,
    counts: Option<Array>,
}

impl Blend {
    fn project(&self, image: Array, low: &Low) -> Array {
        let Low { values, counts } = low;
        back_project(
            image,
            values,
            counts.as_ref(),
            self.back_projection,
            [0.0, 1.0],
        )
    }

    /// Shapes: `images` and `own` `[1, C, H, W]`, `low` `[1, C, h, w]`, values from 0 to 1.
    fn detail(&self, images: Array, own: Array, low: &Low) -> Detail {
        let base = resize(
            &low.values,
            images.shape()[2],
            images.shape()[3],
            Filter::BicubicTorch,
            false,
        );
        // All three are brought in line with the photo first. So details differ only in what the
        // photo does not show.
        let base = self.project(base, low);
        let images = sub(&self.project(images, low), &base);
        let own = sub(&self.project(own, low), &base);
        Detail { base, images, own }
    }

    fn sum(&self, detail: &Detail, shares: Shares, low: &Low) -> Array {
        let Detail { base, images, own } = detail;
        let terms = [
            // The base is in line with the photo already, so that only details have shares.
            (1.0, base),
            (shares.images as f32, images),
            (shares.own as f32, own),
        ];
        self.project(scaled_sum(&terms), low)
    }

    fn colours(&self, views: &Views, device: &Device) -> (Detail, Low) {
        let array = |view: &View| convert::srgb_array(view, device);
        let low = Low {
            values: array(&views.low),
            // [1, 3, h, w]
            counts: masks::factors(&views.low, 3, device),
        };
        (
            self.detail(array(&views.images), array(&views.own), &low),
            low,
        )
    }

    fn view(&self, views: &Views, shares: Shares, device: &Device) -> View {
        let array = |view: &View| convert::alpha_array(view, device);
        let alpha = match (array(&views.images), array(&views.own), array(&views.low)) {
            (Some(images), Some(own), Some(values)) => {
                let counts = masks::factors(&views.low, 1, device);
                let low = Low { values, counts };
                let detail = self.detail(images, own, &low);
                Some(self.sum(&detail, shares, &low).to_vec())
            }
            // Without alpha on all sides there is no detail to weigh.
            (images, _, _) => images.map(|alpha| alpha.to_vec()),
        };
        let (detail, low) = self.colours(views, device);
        // Colours and alpha get the same shares, so that an outline and what it bounds stay
        // together.
        let sum = self.sum(&detail, shares, &low);
        View {
            name: views.images.name.clone(),
            camera: views.images.camera,
            pixels: convert::disk_pixels(&sum, alpha),
            depth: None,
            mask: views.mask(),
        }
    }
}

impl Stage for Blend {
    fn kind(&self) -> &'static str {
        "Blend"
    }

    fn version(&self) -> u32 {
        2
    }

    fn check(&self) -> Result<(), StageError> {
        convert::number_in_range("own_gain", self.own_gain, 0.0, 10.0)?;
        convert::in_range("back_projection", self.back_projection, 0, 1000)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            IMAGES.input(&self.images),
            OWN.input(&self.own),
            LOW.input(&self.low),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![IMAGES.output()]
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [(IMAGES.name, input(inputs, IMAGES.name))].into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let written = input(inputs, IMAGES.name);
        let seconds = written.pixels as f64 * PIXEL_SECONDS;
        Estimate::streaming(inputs, written, WORKED).computing(64 << 20, seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let sets = Sets::open(io)?;
        let count = sets.images.cameras().len();
        // Details are made twice rather than kept: a scene of hundreds of photos would not fit into
        // memory.
        let mut moments = Moments::default();
        for (done, views) in sets.views().enumerate() {
            let views = views?;
            let (detail, _) = self.colours(&views, io.device);
            moments.add(&detail.images, &detail.own, views.mask().as_deref());
            io.progress(done + 1, 2 * count, &[])?;
        }
        let shares = moments.shares(self.own_gain);
        io.metric("share of the enlargement's detail", shares.images);
        io.metric("share of the field's detail", shares.own);
        let mut out = io.image_writer(IMAGES, sets.images.bounds, sets.images.to_source);
        for (done, views) in sets.views().enumerate() {
            out.add(self.view(&views?, shares, io.device))?;
            io.progress(count + done + 1, 2 * count, &[])?;
        }
        Ok(out.finish()?)
    }
}
