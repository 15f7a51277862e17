//! Writes a scene in the layout of NeRF-synthetic: `transforms_{train,test}.json` and one RGBA PNG
//! per photo. Knows nothing of where the scene comes from.

use std::path::Path;

use formats::{Bounds, Camera, Lens, lens, rows};
use serde_json::{Value, json};

use crate::{Photo, SceneError, picture};

/// Writes `train` and `test` into `folder`, which is created: photos as 8-bit PNGs, cameras
/// exactly.
///
/// Any reader of NeRF-synthetic scenes takes it. What that format has no fields for (focal lengths
/// per axis, distortion, near, far and the scene box) stands in the fields of instant-ngp and ours,
/// so that [`crate::Transforms`] reads the same scene.
///
/// # Errors
/// If the file system says no.
pub fn write_transforms(
    folder: &Path,
    train: &[Photo],
    test: &[Photo],
    bounds: Bounds,
) -> Result<(), SceneError> {
    for (split, photos) in [("train", train), ("test", test)] {
        let images = folder.join(split);
        std::fs::create_dir_all(&images).map_err(|source| SceneError::Io {
            path: images.clone(),
            source,
        })?;
        for photo in photos {
            // Four channels always: that is what NeRF-synthetic's photos have.
            picture::write_rgba(&images.join(format!("{}.png", photo.name)), photo)?;
            write_mask(&folder.join(mask_path(split, photo)), photo)?;
        }
        let frames: Vec<Value> = photos
            .iter()
            .map(|photo| photo_frame(split, photo))
            .collect();
        // Of the first camera; readers that know `fl_x` take each frame's own.
        let angle = photos
            .first()
            .map(|photo| 2.0 * (0.5 * f64::from(photo.camera.width) / photo.camera.fl_x).atan());
        let page = json!({ "camera_angle_x": angle, "aabb": bounds, "frames": frames });
        let path = folder.join(format!("transforms_{split}.json"));
        std::fs::write(&path, format!("{page:#}\n"))
            .map_err(|source| SceneError::Io { path, source })?;
    }
    Ok(())
}

fn photo_frame(split: &str, photo: &Photo) -> Value {
    let mut frame = frame(&format!("./{split}/{}", photo.name), &photo.camera);
    // A path to a mask that is not there would be a warning for every frame.
    if photo.mask.is_some() {
        frame["mask_path"] = json!(mask_path(split, photo));
    }
    frame
}

/// A frame that tells all of a camera.
pub(crate) fn frame(file_path: &str, camera: &Camera) -> Value {
    let mut frame = json!(Lens::of(camera));
    frame["file_path"] = json!(file_path);
    frame["transform_matrix"] = json!(rows::of(&camera.camera_to_world));
    let model = lens::model([camera.distortion].iter());
    // Other models follow from the coefficients and `is_fisheye`; k4 to k6 need the name.
    if model == "FULL_OPENCV" {
        frame["camera_model"] = json!(model);
    }
    frame
}

fn mask_path(split: &str, photo: &Photo) -> String {
    format!("{split}_masks/{}.png", photo.name)
}

/// Writes which pixels count in white, as nerfstudio has it, if some do not.
fn write_mask(path: &Path, photo: &Photo) -> Result<(), SceneError> {
    let Some(mask) = &photo.mask else {
        return Ok(());
    };
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(|source| SceneError::io(folder, source))?;
    picture::write_mask(path, photo, Some(mask), |counts| counts)
}
