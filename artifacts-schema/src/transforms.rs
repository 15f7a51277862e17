//! `transforms.json`: the cameras of an image set, as nerfstudio and instant-ngp read them. It is
//! exact: every number is the shortest text that reads back as the same f64. Knows no pixels.

use std::path::Path;

use formats::{Bounds, Camera, Distortion, rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::canonical;
use crate::error::SchemaError;
use crate::provenance::Provenance;

/// The file's name.
pub const FILE: &str = "transforms.json";

/// The file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Transforms {
    /// `OPENCV`: a pinhole camera, with lens distortion where a lens has coefficients;
    /// `OPENCV_FISHEYE` where all are fisheyes.
    pub camera_model: String,
    /// The scene box: its lower and its upper corner.
    pub aabb: Bounds,
    /// Rows of the similarity that takes these coordinates to those of the files that the scene was
    /// read from; none where they are the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_source: Option<[[f64; 4]; 4]>,
    /// What all cameras share; empty if they differ.
    #[serde(flatten)]
    pub lens: Lens,
    /// One frame per view, sorted by file.
    pub frames: Vec<Frame>,
    /// Where the images come from.
    #[serde(rename = "srnerf")]
    pub provenance: Provenance,
}

/// One view.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Frame {
    /// The image, beside this file.
    pub file_path: String,
    /// Rows of the camera-to-world matrix, OpenGL axes.
    pub transform_matrix: [[f64; 4]; 4],
    /// This camera's own lens, if the cameras differ.
    #[serde(flatten)]
    pub lens: Lens,
}

/// All of a camera but its pose; in pixels, near and far in scene units along the viewing axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Lens {
    /// Width of the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub w: Option<u32>,
    /// Height of the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub h: Option<u32>,
    /// Focal length along x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fl_x: Option<f64>,
    /// Focal length along y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fl_y: Option<f64>,
    /// Principal point, x; the first pixel's centre is at 0.5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    /// Principal point, y, downwards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Lens distortion, OpenCV's coefficient of r²; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Lens distortion, of r⁴; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k2: Option<f64>,
    /// Lens distortion, of r⁶; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k3: Option<f64>,
    /// Lens distortion, first tangential coefficient; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Lens distortion, second tangential coefficient; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Lens distortion below the line, of r², or a fisheye's fourth coefficient; none for most
    /// lenses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k4: Option<f64>,
    /// Lens distortion below the line, of r⁴; none for most lenses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k5: Option<f64>,
    /// Lens distortion below the line, of r⁶; none for most lenses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k6: Option<f64>,
    /// Whether k1 to k4 are those of OpenCV's fisheye; none for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is_fisheye: Option<bool>,
    /// Where the scene begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub near: Option<f64>,
    /// Where the scene ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub far: Option<f64>,
}

impl Lens {
    fn of(camera: &Camera) -> Self {
        let bent = |coefficient: f64| Some(coefficient).filter(|_| !camera.distortion.is_none());
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
}

impl Transforms {
    /// The file for these cameras, given by view name.
    pub fn new(cameras: &[(&str, Camera)], bounds: Bounds, provenance: &Provenance) -> Self {
        let lenses: Vec<Lens> = cameras.iter().map(|(_, camera)| Lens::of(camera)).collect();
        let shared = lenses
            .first()
            .copied()
            .filter(|first| lenses.iter().all(|lens| lens == first));
        let frame = |&(name, camera): &(&str, Camera)| Frame {
            file_path: format!("{name}.exr"),
            transform_matrix: rows::of(&camera.camera_to_world),
            lens: if shared.is_some() {
                Lens::default()
            } else {
                Lens::of(&camera)
            },
        };
        let all_fisheyes =
            !cameras.is_empty() && cameras.iter().all(|(_, camera)| camera.distortion.fisheye);
        let model = if all_fisheyes {
            "OPENCV_FISHEYE"
        } else {
            "OPENCV"
        };
        Self {
            camera_model: model.to_owned(),
            aabb: bounds,
            to_source: None,
            lens: shared.unwrap_or_default(),
            frames: cameras.iter().map(frame).collect(),
            provenance: provenance.clone(),
        }
    }

    /// Reads the file in a folder: it, and its cameras by view name, sorted.
    pub fn read(folder: &Path) -> Result<(Self, Vec<(String, Camera)>), SchemaError> {
        let path = folder.join(FILE);
        let transforms: Self = canonical::read(&path)?;
        let cameras = transforms.cameras().map_err(|error| error.in_file(&path))?;
        Ok((transforms, cameras))
    }

    fn cameras(&self) -> Result<Vec<(String, Camera)>, SchemaError> {
        let mut cameras = self
            .frames
            .iter()
            .map(|frame| self.camera(frame))
            .collect::<Result<Vec<_>, _>>()?;
        cameras.sort_by(|(left, _), (right, _)| left.cmp(right));
        canonical::check_names(cameras.iter().map(|(name, _)| name.as_str()))?;
        Ok(cameras)
    }

    fn distortion(&self, own: &Lens) -> Distortion {
        let or_zero = |own: Option<f64>, shared: Option<f64>| own.or(shared).unwrap_or(0.0);
        Distortion {
            k1: or_zero(own.k1, self.lens.k1),
            k2: or_zero(own.k2, self.lens.k2),
            k3: or_zero(own.k3, self.lens.k3),
            p1: or_zero(own.p1, self.lens.p1),
            p2: or_zero(own.p2, self.lens.p2),
            k4: or_zero(own.k4, self.lens.k4),
            k5: or_zero(own.k5, self.lens.k5),
            k6: or_zero(own.k6, self.lens.k6),
            fisheye: own.is_fisheye.or(self.lens.is_fisheye) == Some(true),
        }
    }

    fn camera(&self, frame: &Frame) -> Result<(String, Camera), SchemaError> {
        let place = format!("frame {:?}", frame.file_path);
        let missing = |field: &str| {
            SchemaError::content(
                &place,
                format!("has no {field}, nor is there one for all frames"),
            )
        };
        let name = frame.file_path.strip_suffix(".exr");
        let name =
            name.ok_or_else(|| SchemaError::content(&place, "is not the name of an .exr file"))?;
        let camera = Camera {
            width: frame.lens.w.or(self.lens.w).ok_or_else(|| missing("w"))?,
            height: frame.lens.h.or(self.lens.h).ok_or_else(|| missing("h"))?,
            fl_x: frame
                .lens
                .fl_x
                .or(self.lens.fl_x)
                .ok_or_else(|| missing("fl_x"))?,
            fl_y: frame
                .lens
                .fl_y
                .or(self.lens.fl_y)
                .ok_or_else(|| missing("fl_y"))?,
            cx: frame
                .lens
                .cx
                .or(self.lens.cx)
                .ok_or_else(|| missing("cx"))?,
            cy: frame
                .lens
                .cy
                .or(self.lens.cy)
                .ok_or_else(|| missing("cy"))?,
            distortion: self.distortion(&frame.lens),
            camera_to_world: rows::matrix(&frame.transform_matrix),
            near: frame
                .lens
                .near
                .or(self.lens.near)
                .ok_or_else(|| missing("near"))?,
            far: frame
                .lens
                .far
                .or(self.lens.far)
                .ok_or_else(|| missing("far"))?,
        };
        canonical::check_camera(&camera, &place)?;
        Ok((name.to_owned(), camera))
    }
}
