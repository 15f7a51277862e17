//! What `transforms.json` says of a lens, for all frames or in one of them, as nerfstudio,
//! instant-ngp and our own image sets write it. Knows no poses.

use glam::DMat4;
use schemars::JsonSchema;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::{Camera, Distortion, json};

/// All of a camera but its pose; in pixels, near and far in scene units along the viewing axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Lens {
    /// Width of the image.
    #[serde(deserialize_with = "whole", skip_serializing_if = "Option::is_none")]
    pub w: Option<u32>,
    /// Height of the image.
    #[serde(deserialize_with = "whole", skip_serializing_if = "Option::is_none")]
    pub h: Option<u32>,
    /// Focal length along x.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub fl_x: Option<f64>,
    /// Focal length along y.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub fl_y: Option<f64>,
    /// Principal point, x; the first pixel's centre is at 0.5.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    /// Principal point, y, downwards.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Lens distortion, OpenCV's coefficient of r²; none for a pinhole.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Lens distortion, of r⁴; none for a pinhole.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k2: Option<f64>,
    /// Lens distortion, of r⁶; none for a pinhole.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k3: Option<f64>,
    /// Lens distortion, first tangential coefficient; none for a pinhole.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Lens distortion, second tangential coefficient; none for a pinhole.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Lens distortion below the line, of r², or a fisheye's fourth coefficient; none for most
    /// lenses.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k4: Option<f64>,
    /// Lens distortion below the line, of r⁴; none for most lenses.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k5: Option<f64>,
    /// Lens distortion below the line, of r⁶; none for most lenses.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub k6: Option<f64>,
    /// Whether k1 to k4 are those of OpenCV's fisheye; none for a pinhole.
    #[serde(deserialize_with = "flag", skip_serializing_if = "Option::is_none")]
    pub is_fisheye: Option<bool>,
    /// Where the scene begins.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub near: Option<f64>,
    /// Where the scene ends.
    #[serde(deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub far: Option<f64>,
}

/// A field without which there is no camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("has no {0}, nor is there one for all frames")]
pub struct MissingField(pub &'static str);

impl Lens {
    /// Names of the fields.
    pub const FIELDS: [&str; 17] = [
        "w",
        "h",
        "fl_x",
        "fl_y",
        "cx",
        "cy",
        "k1",
        "k2",
        "k3",
        "p1",
        "p2",
        "k4",
        "k5",
        "k6",
        "is_fisheye",
        "near",
        "far",
    ];

    /// All that a camera says of it.
    pub fn of(camera: &Camera) -> Self {
        // Of a pinhole nothing is written, so that files of most scenes stay short.
        let bent = |coefficient: f64| Some(coefficient).filter(|_| !camera.distortion.is_none());
        // Written only where they count: k4 to k6 need a model that few programs know.
        let below = |coefficient: f64| Some(coefficient).filter(|value| *value != 0.0);
        Self {
            w: Some(camera.width),
            h: Some(camera.height),
            fl_x: Some(camera.fl_x),
            fl_y: Some(camera.fl_y),
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            k1: bent(camera.distortion.k1),
            k2: bent(camera.distortion.k2),
            k3: bent(camera.distortion.k3),
            p1: bent(camera.distortion.p1),
            p2: bent(camera.distortion.p2),
            k4: below(camera.distortion.k4),
            k5: below(camera.distortion.k5),
            k6: below(camera.distortion.k6),
            is_fisheye: Some(true).filter(|_| camera.distortion.fisheye),
            near: Some(camera.near),
            far: Some(camera.far),
        }
    }

    /// A frame's lens, with what it does not say itself taken from what all frames share.
    pub fn or(&self, shared: &Self) -> Self {
        Self {
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
            k4: self.k4.or(shared.k4),
            k5: self.k5.or(shared.k5),
            k6: self.k6.or(shared.k6),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
            near: self.near.or(shared.near),
            far: self.far.or(shared.far),
        }
    }

    /// How it bends; coefficients that are not there are 0.
    pub fn distortion(&self) -> Distortion {
        Distortion {
            k1: self.k1.unwrap_or(0.0),
            k2: self.k2.unwrap_or(0.0),
            k3: self.k3.unwrap_or(0.0),
            p1: self.p1.unwrap_or(0.0),
            p2: self.p2.unwrap_or(0.0),
            k4: self.k4.unwrap_or(0.0),
            k5: self.k5.unwrap_or(0.0),
            k6: self.k6.unwrap_or(0.0),
            fisheye: self.is_fisheye == Some(true),
        }
    }

    /// The camera that has this lens and stands there.
    ///
    /// # Errors
    /// A lens of which something is not said.
    pub fn camera(&self, camera_to_world: DMat4) -> Result<Camera, MissingField> {
        let real = |field: Option<f64>, name| field.ok_or(MissingField(name));
        Ok(Camera {
            width: self.w.ok_or(MissingField("w"))?,
            height: self.h.ok_or(MissingField("h"))?,
            fl_x: real(self.fl_x, "fl_x")?,
            fl_y: real(self.fl_y, "fl_y")?,
            cx: real(self.cx, "cx")?,
            cy: real(self.cy, "cy")?,
            distortion: self.distortion(),
            camera_to_world,
            near: real(self.near, "near")?,
            far: real(self.far, "far")?,
        })
    }
}

/// The `camera_model` under which all of these lenses can be read: OpenCV's simple one, unless some
/// have k4 to k6 as well, or all are fisheyes.
pub fn model<'a>(lenses: impl Iterator<Item = &'a Distortion> + Clone) -> &'static str {
    let full = |lens: &Distortion| !lens.fisheye && [lens.k4, lens.k5, lens.k6] != [0.0; 3];
    match lenses.clone().next() {
        Some(_) if lenses.clone().all(|lens| lens.fisheye) => "OPENCV_FISHEYE",
        Some(_) if lenses.clone().any(full) => "FULL_OPENCV",
        // Also for pinholes, whose coefficients are all 0.
        _ => "OPENCV",
    }
}

/// A field that may be absent or null.
fn field<'de, D: Deserializer<'de>, T>(
    deserializer: D,
    expected: &str,
    read: impl Fn(&Value) -> Option<T>,
) -> Result<Option<T>, D::Error> {
    // By way of a value, so that the message can say what was found instead.
    let value = Value::deserialize(deserializer)?;
    let wrong = || D::Error::custom(format!("is {}; expected {expected}", json::kind(&value)));
    match &value {
        Value::Null => Ok(None),
        value => read(value).map(Some).ok_or_else(wrong),
    }
}

fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    field(deserializer, "a number", Value::as_f64)
}

fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<bool>, D::Error> {
    field(deserializer, "true or false", Value::as_bool)
}

/// A count of pixels, which files also write as `540.0`.
fn whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u32>, D::Error> {
    let range = 0.0..=f64::from(u32::MAX);
    match number(deserializer)? {
        None => Ok(None),
        Some(count) if range.contains(&count) && count.fract() == 0.0 => Ok(Some(count as u32)),
        Some(_) => Err(D::Error::custom("is not a whole number of pixels")),
    }
}

#[cfg(test)]
mod tests;
