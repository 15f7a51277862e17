//! `Blend`: one image of a network's enlargement and a field's render, by adding up their detail. Knows nothing of how
//! either was made.

use artifacts_schema::{ArtifactKind, ImageSet, View};
use compute::elementwise::scaled_sum;
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use serde::{Deserialize, Serialize};

use crate::back_projection::back_project;
use crate::convert;
use crate::error::StageError;
use crate::stage::{Estimate, Input, InputPort, Io, OutputPort, Sizes, Stage};

/// Adds up the detail that an enlargement and a render of the same view have beyond the low-resolution photo.
///
/// The network has its detail from other pictures, the field from the other photos: their errors have little in common.
/// Each gives less than there is, because squared error punishes guesses. A mean of the two would halve what only one of
/// them knows; the posterior mean adds them, with shares whose sum is above 1.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Blend {
    /// The enlarged photos. Where they have alpha, so has the result.
    pub images: Input,
    /// The field's renders of the same views at the same size.
    pub own: Input,
    /// The low-resolution photos.
    pub low: Input,
    /// Share of the detail of `images` that the result has.
    pub images_share: f64,
    /// Share of the detail of `own` that the result has.
    pub own_share: f64,
    /// Rounds of back-projection onto the low-resolution photos, of both images and of the result.
    pub back_projection: u32,
}

impl Default for Blend {
    /// The shares are near the best for two networks and two scenes; `docs/deviations.md` has the figures.
    fn default() -> Self {
        let none = Input::default;
        Self { images: none(), own: none(), low: none(), images_share: 0.55, own_share: 1.2, back_projection: 3 }
    }
}

impl Blend {
    /// `base + a (images - base) + b (own - base)`, where the base is the enlarged photo `low`.
    /// Shapes: `images` and `own` `[1, C, H, W]`, `low` `[1, C, h, w]`, values from 0 to 1.
    fn sum(&self, images: Array, own: Array, low: &Array) -> Array {
        let project = |image: Array| back_project(image, low, self.back_projection, [0.0, 1.0]);
        let base = project(resize(low, images.shape()[2], images.shape()[3], Filter::BicubicTorch, false));
        let images = project(images);
        let own = project(own);
        let rest = 1.0 - self.images_share - self.own_share;
        let terms = [(self.images_share as f32, &images), (self.own_share as f32, &own), (rest as f32, &base)];
        project(scaled_sum(&terms))
    }

    fn view(&self, images: &View, own: &View, low: &View, device: &Device) -> View {
        let alpha = |view: &View| convert::alpha_array(view, device);
        let alpha = match (alpha(images), alpha(own), alpha(low)) {
            (Some(images), Some(own), Some(low)) => Some(self.sum(images, own, &low).to_vec()),
            (images, _, _) => images.map(|alpha| alpha.to_vec()),
        };
        let colours = |view: &View| convert::srgb_array(view, device);
        let rgb = self.sum(colours(images), colours(own), &colours(low));
        let rgb = convert::disk_pixels(&rgb, alpha.as_deref());
        View { name: images.name.clone(), camera: images.camera, rgb, alpha, depth: None }
    }
}

/// Refuses two images of one view that differ in size.
fn check_sizes(images: &View, own: &View) -> Result<(), StageError> {
    let size = |view: &View| (view.camera.width, view.camera.height);
    let (images_size, own_size) = (size(images), size(own));
    if images_size == own_size {
        return Ok(());
    }
    Err(StageError::Mismatch(format!(
        "the view `{}` has {}x{} pixels in `images` and {}x{} in `own`; render at the same scale as the enlargement",
        images.name, images_size.0, images_size.1, own_size.0, own_size.1
    )))
}

impl Stage for Blend {
    fn kind(&self) -> &'static str {
        "Blend"
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<(), StageError> {
        for (field, share) in [("images_share", self.images_share), ("own_share", self.own_share)] {
            if !(share >= 0.0 && share <= 10.0) {
                return Err(StageError::parameter(field, format!("is {share}; it must be 0 to 10")));
            }
        }
        convert::in_range("back_projection", self.back_projection, 0, 1000)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![
            InputPort::new("images", &self.images, ArtifactKind::Images),
            InputPort::new("own", &self.own, ArtifactKind::Images),
            InputPort::new("low", &self.low, ArtifactKind::Images),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![OutputPort { name: "images", kind: ArtifactKind::Images }]
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        Estimate::reading(inputs).computing(64 << 20, 2.0)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images: ImageSet = io.read("images")?;
        let own: ImageSet = io.read("own")?;
        let low: ImageSet = io.read("low")?;
        let mut views = Vec::new();
        for (done, view) in images.views.iter().enumerate() {
            let own = convert::view_named(&own, &view.name)?;
            let low = convert::view_named(&low, &view.name)?;
            check_sizes(view, own)?;
            views.push(self.view(view, own, low, io.device));
            io.progress(done + 1, images.views.len(), &[])?;
        }
        io.write("images", &ImageSet { views, bounds: images.bounds })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(device: &Device, side: usize, value: impl Fn(usize) -> f32) -> Array {
        device.array(&[1, 1, side, side], (0..side * side).map(value).collect())
    }

    #[test]
    fn detail_that_both_have_is_added_up_on_the_photo() {
        let device = Device::cpu();
        let low = image(&device, 2, |_| 0.5);
        let checks = |height: f32| move |i: usize| 0.5 + if (i / 8 + i) % 2 == 0 { height } else { -height };
        let blend = Blend { images_share: 0.5, own_share: 1.0, back_projection: 1, ..Blend::default() };
        let sum = blend.sum(image(&device, 8, checks(0.1)), image(&device, 8, checks(0.2)), &low).to_vec();
        let wanted = checks(0.5 * 0.1 + 0.2);
        assert!(sum.iter().enumerate().all(|(i, x)| (x - wanted(i)).abs() < 0.02), "{sum:?}");
    }

    #[test]
    fn what_contradicts_the_photo_is_taken_back() {
        let device = Device::cpu();
        let low = image(&device, 4, |_| 0.5);
        let blend = Blend { back_projection: 5, ..Blend::default() };
        let sum = blend.sum(image(&device, 16, |_| 0.7), image(&device, 16, |_| 0.2), &low).to_vec();
        assert!(sum.iter().all(|x| (x - 0.5).abs() < 1e-3), "{sum:?}");
    }

    #[test]
    fn a_share_below_nothing_is_refused() {
        let blend = Blend { own_share: -0.1, ..Blend::default() };
        assert_eq!(blend.check().unwrap_err().to_string(), "`own_share` is -0.1; it must be 0 to 10");
    }
}
