//! `transforms.json`: the cameras of an image set, as nerfstudio and instant-ngp read them. It is
//! exact: every number is the shortest text that reads back as the same f64. Knows no pixels.

use std::path::Path;

use formats::{Bounds, Camera, Lens, lens, rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::canonical;
use crate::error::SchemaError;
use crate::provenance::Provenance;

/// The name of the file in an image set's folder.
pub const FILE: &str = "transforms.json";

/// The file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Transforms {
    /// `OPENCV`: a pinhole camera, with lens distortion where a lens has coefficients;
    /// `FULL_OPENCV` where some have k4 to k6, `OPENCV_FISHEYE` where all are fisheyes.
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

impl Transforms {
    /// The file for these cameras, given by view name.
    pub fn new(cameras: &[(&str, Camera)], bounds: Bounds, provenance: &Provenance) -> Self {
        let lenses: Vec<Lens> = cameras.iter().map(|(_, camera)| Lens::of(camera)).collect();
        // One lens for all stands once, so that the file of hundreds of views stays short.
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
        let distortions = cameras.iter().map(|(_, camera)| &camera.distortion);
        Self {
            camera_model: lens::model(distortions).to_owned(),
            aabb: bounds,
            to_source: None,
            lens: shared.unwrap_or_default(),
            frames: cameras.iter().map(frame).collect(),
            provenance: provenance.clone(),
        }
    }

    /// Reads the file in a folder: it, and its cameras by view name, sorted.
    pub fn read(folder: &Path) -> Result<(Self, Vec<(String, Camera)>), SchemaError> {
        Self::cameras_of(&folder.join(FILE))
    }

    /// The same of the file at this path.
    pub fn cameras_of(path: &Path) -> Result<(Self, Vec<(String, Camera)>), SchemaError> {
        let transforms: Self = canonical::read(path)?;
        let cameras = transforms.cameras().map_err(|error| error.in_file(path))?;
        Ok((transforms, cameras))
    }

    fn cameras(&self) -> Result<Vec<(String, Camera)>, SchemaError> {
        let mut cameras = self
            .frames
            .iter()
            .map(|frame| self.camera(frame))
            .collect::<Result<Vec<_>, _>>()?;
        // The file may have been edited: the order of frames means nothing.
        cameras.sort_by(|(left, _), (right, _)| left.cmp(right));
        canonical::check_names(cameras.iter().map(|(name, _)| name.as_str()))?;
        Ok(cameras)
    }

    fn camera(&self, frame: &Frame) -> Result<(String, Camera), SchemaError> {
        let place = format!("frame {:?}", frame.file_path);
        let refuse = |problem: &dyn ToString| SchemaError::content(&place, problem.to_string());
        // The view's name is the file's stem, so that the set can be moved as a folder.
        let name = frame.file_path.strip_suffix(".exr");
        let name = name.ok_or_else(|| refuse(&"is not the name of an .exr file"))?;
        let lens = frame.lens.or(&self.lens);
        let camera = lens
            .camera(rows::matrix(&frame.transform_matrix))
            .map_err(|missing| refuse(&missing))?;
        // A foreign file: a pose that cannot be inverted would give NaN far from here.
        canonical::check_camera(&camera, &place)?;
        Ok((name.to_owned(), camera))
    }
}
