//! A COLMAP reconstruction as its files hold it, text or binary alike: lenses, poses, sparse points. Knows no photos.
//!
//! Format: <https://colmap.github.io/format.html>.

use std::collections::BTreeMap;

use glam::{DMat4, DQuat, DVec3};

use crate::{Camera, Distortion, pose};

/// What a reconstruction says.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Model {
    /// Lenses by their number; their pose, near and far say nothing.
    pub(super) lenses: BTreeMap<u32, Camera>,
    /// Registered photos by their number.
    pub(super) images: BTreeMap<u32, Image>,
    pub(super) points: Vec<Point>,
}

/// A registered photo.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Image {
    /// Its path in the folder of photos.
    pub(super) name: String,
    pub(super) lens: u32,
    pub(super) camera_to_world: DMat4,
}

/// A sparse point and the numbers of the images that it was found in.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) position: [f64; 3],
    pub(super) seen_in: Vec<u32>,
}

/// COLMAP's camera models by number: name and count of parameters.
const MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];
/// The models from this one on are no pinholes with k1, k2, p1 and p2.
const FIRST_UNKNOWN: usize = 5;

/// A camera model that we can undo, by its number: its name and its count of parameters.
pub(super) fn model_by_number(number: i32) -> Result<(&'static str, usize), String> {
    let known = usize::try_from(number)
        .ok()
        .and_then(|number| Some((number, MODELS.get(number)?)));
    match known {
        Some((number, model)) if number < FIRST_UNKNOWN => Ok(*model),
        Some((_, (name, _))) => Err(unsupported(name)),
        None => Err(unsupported(&format!("number {number}"))),
    }
}

/// The same by name.
pub(super) fn model_by_name(name: &str) -> Result<(&'static str, usize), String> {
    let known = MODELS[..FIRST_UNKNOWN]
        .iter()
        .find(|(known, _)| *known == name);
    known.copied().ok_or_else(|| unsupported(name))
}

fn unsupported(model: &str) -> String {
    let known: Vec<&str> = MODELS[..FIRST_UNKNOWN]
        .iter()
        .map(|(name, _)| *name)
        .collect();
    format!(
        "the camera model {model} is not known here ({}); run COLMAP's image_undistorter first",
        known.join(", ")
    )
}

/// A lens of a model with its parameters, as many as the model has.
pub(super) fn lens(
    model: &str,
    (width, height): (u64, u64),
    parameters: &[f64],
) -> Result<Camera, String> {
    let bent = |k1, k2, p1, p2| Distortion {
        k1,
        k2,
        k3: 0.0,
        p1,
        p2,
    };
    let (fl_x, fl_y, cx, cy, distortion) = match *parameters {
        [f, x, y] => (f, f, x, y, bent(0.0, 0.0, 0.0, 0.0)),
        [fx, fy, x, y] if model == "PINHOLE" => (fx, fy, x, y, bent(0.0, 0.0, 0.0, 0.0)),
        [f, x, y, k] => (f, f, x, y, bent(k, 0.0, 0.0, 0.0)),
        [f, x, y, k1, k2] => (f, f, x, y, bent(k1, k2, 0.0, 0.0)),
        [fx, fy, x, y, k1, k2, p1, p2] => (fx, fy, x, y, bent(k1, k2, p1, p2)),
        _ => return Err(format!("{model} has {} parameters", parameters.len())),
    };
    let side = |pixels: u64| {
        u32::try_from(pixels)
            .ok()
            .filter(|side| (1..=1 << 16).contains(side))
    };
    let size = side(width).zip(side(height));
    let (width, height) =
        size.ok_or_else(|| format!("its size is {width}x{height}; expected 1 to 65536 pixels"))?;
    let camera_to_world = DMat4::IDENTITY;
    let camera = Camera {
        width,
        height,
        fl_x,
        fl_y,
        cx,
        cy,
        distortion,
        camera_to_world,
        near: 1.0,
        far: 2.0,
    };
    pose::check(&camera)?;
    Ok(camera)
}

/// COLMAP's world-to-camera rotation (w, x, y, z) and translation, with its axes right, down, forwards, as our pose.
pub(super) fn camera_to_world(
    [w, x, y, z]: [f64; 4],
    translation: [f64; 3],
) -> Result<DMat4, String> {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let finite = translation.iter().all(|value| value.is_finite());
    // A quaternion of another length is still a direction; COLMAP normalises as well.
    if !(length > 1e-6 && length.is_finite() && finite) {
        return Err("its rotation or translation is not one".into());
    }
    let turn = DQuat::from_xyzw(x, y, z, w).normalize();
    let to_camera = DMat4::from_rotation_translation(turn, DVec3::from(translation));
    let mut pose = to_camera.inverse();
    // From down and forwards to up and backwards.
    (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
    Ok(pose)
}
