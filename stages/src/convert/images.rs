//! Images on disk (scene-linear) and images in the libraries: sRGB-encoded, since fields are
//! trained, networks run and metrics taken on display-encoded values. How the one becomes the other
//! is in [`Pixels`].

use artifacts_schema::{StoredImages, View};
use compute::{Array, Device};
use formats::pixels::{interleaved, planes};
use formats::{Camera, Linear, Pixels};
use nerf::{Mask, Rendered, TrainView};
use scene::Photo;

use crate::error::StageError;

/// The view of this name.
pub fn view_named(images: &StoredImages, name: &str) -> Result<View, StageError> {
    Ok(images.view(place_named(images, name)?)?)
}

/// The place of the view of this name.
pub fn place_named(images: &StoredImages, name: &str) -> Result<usize, StageError> {
    images.find(name).ok_or_else(|| {
        StageError::Mismatch(format!("an input image set has no view named `{name}`"))
    })
}

/// The view's colours, interleaved, sRGB-encoded; where there is alpha, before black.
pub fn srgb(view: &View) -> Vec<f32> {
    srgb_before(view, 0.0)
}

/// The view's colours, interleaved, sRGB-encoded; where there is alpha, before a grey of this sRGB
/// value.
pub fn srgb_before(view: &View, background: f32) -> Vec<f32> {
    view.pixels.encoded().before(background).rgb
}

/// [1, 3, H, W], sRGB-encoded, 0 to 1.
pub fn srgb_array(view: &View, device: &Device) -> Array {
    array(&srgb(view), view, device)
}

/// [1, 3, H, W], scene-linear.
pub fn linear_array(view: &View, device: &Device) -> Array {
    array(&view.pixels.rgb, view, device)
}

/// [1, 3, H, W], sRGB-encoded, -1 to 1: what the prior's networks take.
pub fn signed_array(view: &View, device: &Device) -> Array {
    // The range that the autoencoder was trained on.
    let values: Vec<f32> = srgb(view).iter().map(|x| 2.0 * x - 1.0).collect();
    array(&values, view, device)
}

/// [1, 1, H, W], coverage from 0 to 1.
pub fn alpha_array(view: &View, device: &Device) -> Option<Array> {
    let h = view.camera.height as usize;
    let w = view.camera.width as usize;
    view.pixels
        .alpha
        .as_ref()
        .map(|alpha| device.array(&[1, 1, h, w], alpha.clone()))
}

fn array(rgb: &[f32], view: &View, device: &Device) -> Array {
    let h = view.camera.height as usize;
    let w = view.camera.width as usize;
    device.array(&[1, 3, h, w], planes(rgb, 3))
}

/// Interleaved colours of an [1, 3, H, W] array, as they are.
pub fn pixels(image: &Array) -> Vec<f32> {
    interleaved(&image.to_vec(), 3)
}

/// Pixels for disk of an sRGB-encoded array before black, of which `alpha` is in front of it; what
/// lies outside 0 to 1 is clipped.
pub fn disk_pixels(image: &Array, alpha: Option<Vec<f32>>) -> Pixels<Linear> {
    Pixels::of_before_black(pixels(image), alpha).linear()
}

/// Pixels for disk of an array in -1 to 1, as the prior has it; [`disk_pixels`] otherwise.
pub fn disk_pixels_of_signed(image: &Array, alpha: Option<Vec<f32>>) -> Pixels<Linear> {
    let before_black = pixels(image).iter().map(|x| 0.5 * x + 0.5).collect();
    Pixels::of_before_black(before_black, alpha).linear()
}

/// A photo for disk.
pub fn photo_view(photo: &Photo) -> View {
    View {
        name: photo.name.clone(),
        camera: photo.camera,
        pixels: photo.pixels.linear(),
        depth: None,
        mask: photo.mask.clone(),
    }
}

/// The photo that [`photo_view`] was called on.
pub fn view_photo(view: &View) -> Photo {
    Photo {
        name: view.name.clone(),
        camera: view.camera,
        pixels: view.pixels.encoded(),
        mask: view.mask.clone(),
    }
}

/// A rendered image (before black) for disk, with depth; `alpha` says whether it keeps its opacity.
pub fn rendered_view(name: &str, camera: &Camera, rendered: Rendered, alpha: bool) -> View {
    let alpha = alpha.then_some(rendered.opacity);
    View {
        name: name.to_owned(),
        camera: *camera,
        pixels: Pixels::of_before_black(rendered.rgb, alpha).linear(),
        depth: Some(rendered.depth),
        mask: None,
    }
}

/// A view to train a field on; where there is alpha, the field is to be as transparent.
pub fn train_view(view: View, weight: f32, supersample: u32) -> TrainView {
    TrainView {
        camera: view.camera,
        pixels: view.pixels.encoded().into(),
        mask: view.mask.as_deref().map(Mask::new),
        weight,
        supersample,
    }
}
