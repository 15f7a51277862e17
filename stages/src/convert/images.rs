//! Images on disk (scene-linear) and images in the libraries: sRGB-encoded, since fields are
//! trained, networks run and metrics taken on display-encoded values.

use artifacts_schema::{ImageSet, View};
use compute::{Array, Device};
use formats::Camera;
use formats::color::{linear_to_srgb, srgb_to_linear};
use nerf::{Rendered, TrainView};
use scene::Photo;

use crate::error::StageError;

/// The view of this name.
pub fn view_named<'a>(images: &'a ImageSet, name: &str) -> Result<&'a View, StageError> {
    let found = images.views.iter().find(|view| view.name == name);
    found.ok_or_else(|| {
        StageError::Mismatch(format!("an input image set has no view named `{name}`"))
    })
}

/// The view's colours, interleaved, sRGB-encoded; where there is alpha, before black.
pub fn srgb(view: &View) -> Vec<f32> {
    srgb_before(view, 0.0)
}

/// The view's colours, interleaved, sRGB-encoded; where there is alpha, before a grey of this sRGB
/// value. Composited as radiance fields are, and as NeRF-synthetic's truth is: on encoded values.
pub fn srgb_before(view: &View, background: f32) -> Vec<f32> {
    let straight = straight_srgb(view);
    let Some(alpha) = &view.alpha else {
        return straight;
    };
    let before = |(i, x): (usize, f32)| alpha[i / 3] * x + (1.0 - alpha[i / 3]) * background;
    straight.into_iter().enumerate().map(before).collect()
}

/// The view's colours, interleaved, sRGB-encoded and not multiplied by alpha. On disk they are, in
/// linear light.
fn straight_srgb(view: &View) -> Vec<f32> {
    match &view.alpha {
        None => view.rgb.iter().map(|&x| linear_to_srgb(x)).collect(),
        Some(alpha) => {
            let straight = |(i, &x): (usize, &f32)| {
                if alpha[i / 3] > 0.0 {
                    linear_to_srgb(x / alpha[i / 3])
                } else {
                    0.0
                }
            };
            view.rgb.iter().enumerate().map(straight).collect()
        }
    }
}

/// The inverse of [`straight_srgb`].
fn premultiplied_linear(srgb: &[f32], alpha: Option<&[f32]>) -> Vec<f32> {
    let part = |i: usize| alpha.map_or(1.0, |alpha| alpha[i / 3]);
    srgb.iter()
        .enumerate()
        .map(|(i, &x)| srgb_to_linear(x) * part(i))
        .collect()
}

/// [1, 3, H, W], sRGB-encoded, 0 to 1.
pub fn srgb_array(view: &View, device: &Device) -> Array {
    planes(&srgb(view), view, device)
}

/// [1, 3, H, W], scene-linear.
pub fn linear_array(view: &View, device: &Device) -> Array {
    planes(&view.rgb, view, device)
}

/// [1, 3, H, W], sRGB-encoded, -1 to 1: what the prior's networks take.
pub fn signed_array(view: &View, device: &Device) -> Array {
    let values: Vec<f32> = srgb(view).iter().map(|x| 2.0 * x - 1.0).collect();
    planes(&values, view, device)
}

/// [1, 1, H, W], coverage from 0 to 1.
pub fn alpha_array(view: &View, device: &Device) -> Option<Array> {
    let h = view.camera.height as usize;
    let w = view.camera.width as usize;
    view.alpha
        .as_ref()
        .map(|alpha| device.array(&[1, 1, h, w], alpha.clone()))
}

fn planes(interleaved: &[f32], view: &View, device: &Device) -> Array {
    let h = view.camera.height as usize;
    let w = view.camera.width as usize;
    let values = (0..3)
        .flat_map(|c| interleaved.iter().skip(c).step_by(3).copied())
        .collect();
    device.array(&[1, 3, h, w], values)
}

/// Interleaved colours of an [1, 3, H, W] array, as they are.
pub fn pixels(image: &Array) -> Vec<f32> {
    let values = image.to_vec();
    let plane = values.len() / 3;
    (0..plane)
        .flat_map(|i| [values[i], values[plane + i], values[2 * plane + i]])
        .collect()
}

/// Colours for disk of an sRGB-encoded array before black, of which `alpha` is in front of it; what
/// lies outside 0 to 1 is clipped.
pub fn disk_pixels(image: &Array, alpha: Option<&[f32]>) -> Vec<f32> {
    premultiplied_linear(&straight(pixels(image), alpha), alpha)
}

/// The same for an array in -1 to 1.
pub fn disk_pixels_of_signed(image: &Array, alpha: Option<&[f32]>) -> Vec<f32> {
    let before_black = pixels(image).iter().map(|x| 0.5 * x + 0.5).collect();
    premultiplied_linear(&straight(before_black, alpha), alpha)
}

/// What gives these colours when `alpha` of it is in front of black.
fn straight(before_black: Vec<f32>, alpha: Option<&[f32]>) -> Vec<f32> {
    let part = |i: usize| alpha.map_or(1.0, |alpha| alpha[i / 3]);
    let straight = |(i, x): (usize, f32)| {
        if part(i) > 0.0 {
            (x / part(i)).clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    before_black.into_iter().enumerate().map(straight).collect()
}

/// A photo for disk.
pub fn photo_view(photo: &Photo) -> View {
    View {
        name: photo.name.clone(),
        camera: photo.camera,
        rgb: premultiplied_linear(&photo.rgb, photo.alpha.as_deref()),
        alpha: photo.alpha.clone(),
        depth: None,
        mask: photo.mask.clone(),
    }
}

/// The photo that [`photo_view`] was called on.
pub fn view_photo(view: &View) -> Photo {
    Photo {
        name: view.name.clone(),
        camera: view.camera,
        rgb: straight_srgb(view),
        alpha: view.alpha.clone(),
        mask: view.mask.clone(),
    }
}

/// A rendered image (before black) for disk, with depth; `alpha` says whether it keeps its opacity.
pub fn rendered_view(name: &str, camera: &Camera, rendered: Rendered, alpha: bool) -> View {
    let alpha = alpha.then_some(rendered.opacity);
    View {
        name: name.to_owned(),
        camera: *camera,
        rgb: premultiplied_linear(&straight(rendered.rgb, alpha.as_deref()), alpha.as_deref()),
        alpha,
        depth: Some(rendered.depth),
        mask: None,
    }
}

/// A view to train a field on; where there is alpha, the field is to be as transparent.
pub fn train_view(view: &View, weight: f32, supersample: u32) -> TrainView {
    TrainView {
        camera: view.camera,
        rgb: straight_srgb(view),
        alpha: view.alpha.clone(),
        mask: view.mask.clone(),
        weight,
        supersample,
    }
}
