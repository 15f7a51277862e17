//! A COLMAP reconstruction as its files hold it, text or binary alike: lenses, poses, sparse
//! points. Knows no photos.
//!
//! Format: <https://colmap.github.io/format.html>.

use std::collections::BTreeMap;

use formats::{Camera, Distortion};
use glam::{DMat4, DQuat, DVec3};

use crate::pose;

/// What a reconstruction says.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Model {
    /// Lenses by their number; their pose, near and far say nothing.
    pub(super) lenses: BTreeMap<u32, Camera>,
    /// Registered photos by their number.
    pub(super) images: BTreeMap<u32, Image>,
    pub(super) points: Vec<SparsePoint>,
    /// What had to be guessed to read it.
    pub(super) notes: Vec<String>,
}

impl Model {
    /// Takes up an image. That its name is its own is checked for every format alike.
    pub(super) fn add(&mut self, number: u32, image: Image) -> Result<(), String> {
        // A second record under one number would silently take the first one's place.
        match self.images.insert(number, image) {
            None => Ok(()),
            Some(other) => Err(format!("IMAGE_ID {number} is also that of {}", other.name)),
        }
    }
}

/// A photo that COLMAP registered, as `images.txt` or `images.bin` has it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Image {
    /// Its path in the folder of photos.
    pub(super) name: String,
    pub(super) lens: u32,
    /// Its pose, or what is wrong with it.
    pub(super) camera_to_world: Result<DMat4, String>,
}

/// A sparse point and the numbers of the images that it was found in.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SparsePoint {
    pub(super) position: [f64; 3],
    /// Mean distance in pixels between where photos show it and where it should be; below zero
    /// where nobody has measured it.
    pub(super) error: f64,
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

/// A camera model by its number: its name and its count of parameters.
pub(super) fn model_by_number(number: i32) -> Result<(&'static str, usize), String> {
    let known = usize::try_from(number)
        .ok()
        .and_then(|number| MODELS.get(number));
    known
        .copied()
        .ok_or_else(|| unsupported(&format!("number {number}")))
}

/// A camera model by its name, in any case.
pub(super) fn model_by_name(name: &str) -> Result<(&'static str, usize), String> {
    let known = MODELS
        .iter()
        .find(|(known, _)| known.eq_ignore_ascii_case(name));
    known.copied().ok_or_else(|| unsupported(name))
}

fn unsupported(model: &str) -> String {
    let known: Vec<&str> = MODELS.iter().map(|(name, _)| *name).collect();
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
    let (pinhole, distortion) = parts(model, parameters)?;
    let [fl_x, fl_y, cx, cy] = pinhole;
    let side = |pixels: u64| {
        u32::try_from(pixels)
            .ok()
            // Bounded, since sizes come from a foreign file and areas are computed of them.
            .filter(|side| (1..=1 << 16).contains(side))
    };
    let size = side(width).zip(side(height));
    let (width, height) =
        size.ok_or_else(|| format!("its size is {width}x{height}; expected 1 to 65536 pixels"))?;
    let camera = Camera {
        width,
        height,
        fl_x,
        fl_y,
        cx,
        cy,
        distortion,
        camera_to_world: DMat4::IDENTITY,
        // Placeholders: near and far follow from the points.
        near: 1.0,
        far: 2.0,
    };
    pose::check(&camera)?;
    Ok(camera)
}

/// Focal lengths and principal point, and how the lens bends, by the parameters' order in COLMAP's
/// documentation.
fn parts(model: &str, parameters: &[f64]) -> Result<([f64; 4], Distortion), String> {
    let none = Distortion::default();
    let other = |what: &str| {
        Err(format!(
            "its model {model} has {what}, which is not undone here; run COLMAP's image_undistorter first"
        ))
    };
    Ok(match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, x, y]) => ([f, f, x, y], none),
        ("PINHOLE", &[fx, fy, x, y]) => ([fx, fy, x, y], none),
        ("SIMPLE_RADIAL", &[f, x, y, k1]) => ([f, f, x, y], Distortion { k1, ..none }),
        ("RADIAL", &[f, x, y, k1, k2]) => ([f, f, x, y], Distortion { k1, k2, ..none }),
        ("OPENCV", &[fx, fy, x, y, k1, k2, p1, p2]) => {
            let bent = Distortion {
                k1,
                k2,
                p1,
                p2,
                ..none
            };
            ([fx, fy, x, y], bent)
        }
        ("FULL_OPENCV", &[fx, fy, x, y, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let bent = Distortion {
                k1,
                k2,
                k3,
                p1,
                p2,
                k4,
                k5,
                k6,
                fisheye: false,
            };
            ([fx, fy, x, y], bent)
        }
        ("OPENCV_FISHEYE", &[fx, fy, x, y, k1, k2, k3, k4]) => {
            ([fx, fy, x, y], Distortion::fisheye([k1, k2, k3, k4]))
        }
        ("SIMPLE_RADIAL_FISHEYE", &[f, x, y, k1]) => {
            ([f, f, x, y], Distortion::fisheye([k1, 0.0, 0.0, 0.0]))
        }
        ("RADIAL_FISHEYE", &[f, x, y, k1, k2]) => {
            ([f, f, x, y], Distortion::fisheye([k1, k2, 0.0, 0.0]))
        }
        // Without omega its lens does not bend.
        ("FOV", &[fx, fy, x, y, omega]) if omega.abs() < 1e-9 => ([fx, fy, x, y], none),
        ("FOV", &[.., omega]) => return other(&format!("omega = {omega}")),
        ("THIN_PRISM_FISHEYE", &[fx, fy, x, y, k1, k2, p1, p2, k3, k4, sx, sy]) => {
            // Without them the model is OpenCV's fisheye.
            if [p1, p2, sx, sy] != [0.0; 4] {
                return other(&format!("p1 = {p1}, p2 = {p2}, sx1 = {sx}, sy1 = {sy}"));
            }
            ([fx, fy, x, y], Distortion::fisheye([k1, k2, k3, k4]))
        }
        _ => return Err(format!("{model} has not {} parameters", parameters.len())),
    })
}

/// COLMAP's world-to-camera rotation (w, x, y, z) and translation, with its axes right, down,
/// forwards, as our pose.
pub(super) fn camera_to_world(
    [w, x, y, z]: [f64; 4],
    translation: [f64; 3],
) -> Result<DMat4, String> {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let finite = translation.iter().all(|value| value.is_finite());
    // A quaternion of another length is still a direction; COLMAP normalises as well.
    if !(length > 1e-6 && length.is_finite() && finite) {
        return Err(format!(
            "its rotation ({w}, {x}, {y}, {z}) or translation {translation:?} is none; expected finite numbers"
        ));
    }
    let turn = DQuat::from_xyzw(x, y, z, w).normalize();
    // COLMAP's pose takes world to camera; ours is the way back.
    let to_camera = DMat4::from_rotation_translation(turn, DVec3::from(translation));
    let mut pose = to_camera.inverse();
    // From down and forwards to up and backwards.
    (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
    Ok(pose)
}
