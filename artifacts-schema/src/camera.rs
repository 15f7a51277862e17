//! A camera as files hold it. Knows no rays and no images.

use glam::DMat4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::SchemaError;

/// Images are at most this wide and high.
const LARGEST_EXTENT: u32 = 1 << 16;

/// OpenCV's lens distortion, in focal lengths with y down: radial and tangential, or its fisheye;
/// all zero is a pinhole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Distortion {
    /// Coefficient of r².
    pub k1: f64,
    /// Coefficient of r⁴.
    pub k2: f64,
    /// Coefficient of r⁶.
    pub k3: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Coefficient of r² below the line, or a fisheye's fourth.
    #[serde(skip_serializing_if = "is_zero")]
    pub k4: f64,
    /// Coefficient of r⁴ below the line.
    #[serde(skip_serializing_if = "is_zero")]
    pub k5: f64,
    /// Coefficient of r⁶ below the line.
    #[serde(skip_serializing_if = "is_zero")]
    pub k6: f64,
    /// Whether k1 to k4 are those of OpenCV's fisheye, of angles instead of r.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub fisheye: bool,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Distortion {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// All coefficients, in the order of the fields, and 1 for a fisheye; the last four only where
    /// one of them is not 0.
    pub(crate) fn coefficients(&self) -> Vec<f64> {
        let first = [self.k1, self.k2, self.k3, self.p1, self.p2];
        let fisheye = f64::from(u8::from(self.fisheye));
        let last = [self.k4, self.k5, self.k6, fisheye];
        match last == [0.0; 4] {
            true => first.to_vec(),
            false => [&first[..], &last].concat(),
        }
    }
}

/// A camera. Lengths in the image are in pixels; pixel (0, 0) has its centre at (0.5, 0.5), y
/// points down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Camera {
    /// Width of the image.
    pub width: u32,
    /// Height of the image.
    pub height: u32,
    /// Focal length along x.
    pub fl_x: f64,
    /// Focal length along y.
    pub fl_y: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
    /// How the lens bends what a pinhole would see.
    #[serde(default, skip_serializing_if = "Distortion::is_none")]
    pub distortion: Distortion,
    /// Rows of the camera-to-world matrix. OpenGL axes: +x right, +y up, looks along -z.
    pub camera_to_world: [[f64; 4]; 4],
    /// Where the scene begins, along the viewing axis, in scene units.
    pub near: f64,
    /// Where the scene ends, along the viewing axis, in scene units.
    pub far: f64,
}

impl Camera {
    /// Refuses sizes that no image has, numbers that JSON cannot hold, and poses that cannot be
    /// inverted.
    pub(crate) fn check(&self, place: &str) -> Result<(), SchemaError> {
        let extents = 1..=LARGEST_EXTENT;
        if !extents.contains(&self.width) || !extents.contains(&self.height) {
            let problem = format!(
                "is {}x{}; expected 1 to {LARGEST_EXTENT} pixels each way",
                self.width, self.height
            );
            return Err(SchemaError::content(place, problem));
        }
        let lens = [self.fl_x, self.fl_y, self.cx, self.cy, self.near, self.far];
        let bent = self.distortion.coefficients();
        let mut numbers = lens
            .iter()
            .chain(&bent)
            .chain(self.camera_to_world.as_flattened());
        match numbers.find(|number| !number.is_finite()) {
            Some(number) => Err(SchemaError::content(
                place,
                format!("its camera holds {number}; all must be finite"),
            )),
            None if self.determinant() == 0.0 => Err(SchemaError::content(
                place,
                "its camera-to-world matrix cannot be inverted",
            )),
            None => Ok(()),
        }
    }

    fn determinant(&self) -> f64 {
        DMat4::from_cols_array_2d(&self.camera_to_world).determinant()
    }
}

/// Refuses a scene box that JSON cannot hold.
pub(crate) fn check_bounds(bounds: &[[f64; 3]; 2]) -> Result<(), SchemaError> {
    match bounds
        .as_flattened()
        .iter()
        .find(|number| !number.is_finite())
    {
        Some(number) => Err(SchemaError::content(
            "bounds",
            format!("holds {number}; all must be finite"),
        )),
        None => Ok(()),
    }
}
