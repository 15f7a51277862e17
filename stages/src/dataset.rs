//! Image sets as a scene on disk that other programs train on. Knows nothing of how they came
//! about.

use std::path::Path;

use artifacts_schema::ImageSet;
use glam::DVec3;
use scene::Photo;

use crate::convert;
use crate::error::StageError;

/// Writes image sets in the layout of NeRF-synthetic (see [`scene::write_transforms`]); the
/// training set's box is the scene's. A scene that was moved to the origin, since its files'
/// coordinates are large, goes back to them.
///
/// # Errors
/// If the file system says no.
pub fn write(folder: &Path, train: &ImageSet, test: Option<&ImageSet>) -> Result<(), StageError> {
    let back = train.to_source.and_then(shift);
    let photos = |images: &ImageSet| {
        let photos = images.views.iter().map(convert::view_photo);
        photos
            .map(|photo| match back {
                Some((offset, scale)) => moved(photo, offset, scale),
                None => photo,
            })
            .collect::<Vec<Photo>>()
    };
    let bounds = match back {
        Some((offset, scale)) => train
            .bounds
            .map(|corner| (DVec3::from(corner) * scale + offset).to_array()),
        None => train.bounds,
    };
    Ok(scene::write_transforms(
        folder,
        &photos(train),
        &test.map(photos).unwrap_or_default(),
        bounds,
    )?)
}

/// The offset and the scale of a similarity without a turn; `None` for one that turns, by which an
/// axis-aligned box would not be one any more.
fn shift(to_source: [[f64; 4]; 4]) -> Option<(DVec3, f64)> {
    let scale = to_source[0][0];
    let is_plain =
        (0..3).all(|i| (0..3).all(|j| to_source[i][j] == if i == j { scale } else { 0.0 }));
    let offset = DVec3::new(to_source[0][3], to_source[1][3], to_source[2][3]);
    is_plain.then_some((offset, scale))
}

/// A photo in coordinates that are `scale` times as large and then moved by `offset`.
fn moved(mut photo: Photo, offset: DVec3, scale: f64) -> Photo {
    let camera = &mut photo.camera;
    let position = camera.position() * scale + offset;
    camera.camera_to_world.w_axis = position.extend(1.0);
    camera.near *= scale;
    camera.far *= scale;
    photo
}
