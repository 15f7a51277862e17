//! Images on disk (scene-linear) and images in the libraries: sRGB-encoded, since fields are trained, networks run and
//! metrics taken on display-encoded values.

use artifacts_schema::{ImageSet, View};
use compute::{Array, Device};
use nerf::{Rendered, TrainView};
use scene::color::{linear_to_srgb, srgb_to_linear};
use scene::{Camera, Photo};

use super::cameras::{camera, disk_camera};
use crate::error::StageError;

/// The view of this name.
pub fn view_named<'a>(images: &'a ImageSet, name: &str) -> Result<&'a View, StageError> {
    let found = images.views.iter().find(|view| view.name == name);
    found.ok_or_else(|| StageError::Mismatch(format!("an input image set has no view named `{name}`")))
}

/// The view's colours, interleaved, sRGB-encoded.
pub fn srgb(view: &View) -> Vec<f32> {
    view.rgb.iter().map(|&x| linear_to_srgb(x)).collect()
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

fn planes(interleaved: &[f32], view: &View, device: &Device) -> Array {
    let (h, w) = (view.camera.height as usize, view.camera.width as usize);
    let values = (0..3).flat_map(|c| interleaved.iter().skip(c).step_by(3).copied()).collect();
    device.array(&[1, 3, h, w], values)
}

/// Interleaved colours of an [1, 3, H, W] array, as they are.
pub fn pixels(image: &Array) -> Vec<f32> {
    let values = image.to_vec();
    let plane = values.len() / 3;
    (0..plane).flat_map(|i| [values[i], values[plane + i], values[2 * plane + i]]).collect()
}

/// Interleaved scene-linear colours of an sRGB-encoded array; what lies outside 0 to 1 is clipped.
pub fn linear_pixels(image: &Array) -> Vec<f32> {
    pixels(image).iter().map(|x| srgb_to_linear(x.clamp(0.0, 1.0))).collect()
}

/// The same for an array in -1 to 1.
pub fn linear_pixels_of_signed(image: &Array) -> Vec<f32> {
    pixels(image).iter().map(|x| srgb_to_linear((0.5 * x + 0.5).clamp(0.0, 1.0))).collect()
}

/// A photo for disk.
pub fn photo_view(photo: &Photo) -> View {
    View {
        name: photo.name.clone(),
        camera: disk_camera(&photo.camera),
        rgb: photo.rgb.iter().map(|&x| srgb_to_linear(x)).collect(),
        alpha: photo.alpha.clone(),
        depth: None,
    }
}

/// A rendered image for disk, with opacity and depth.
pub fn rendered_view(name: &str, camera: &Camera, rendered: Rendered) -> View {
    View {
        name: name.to_owned(),
        camera: disk_camera(camera),
        rgb: rendered.rgb.iter().map(|x| srgb_to_linear(x.clamp(0.0, 1.0))).collect(),
        alpha: Some(rendered.opacity),
        depth: Some(rendered.depth),
    }
}

/// A view to train a field on.
pub fn train_view(view: &View, weight: f32, supersample: u32) -> TrainView {
    TrainView { camera: camera(&view.camera), rgb: srgb(view), alpha: None, weight, supersample }
}
