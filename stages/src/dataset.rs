//! Image sets as a scene on disk that other programs train on. Knows nothing of how they came
//! about.

use std::path::Path;

use artifacts_schema::ImageSet;
use scene::Photo;

use crate::convert;
use crate::error::StageError;

/// Writes image sets in the layout of NeRF-synthetic (see [`scene::write_transforms`]); the
/// training set's box is the scene's.
///
/// # Errors
/// If the file system says no.
pub fn write(folder: &Path, train: &ImageSet, test: Option<&ImageSet>) -> Result<(), StageError> {
    let photos = |images: &ImageSet| {
        images
            .views
            .iter()
            .map(convert::view_photo)
            .collect::<Vec<Photo>>()
    };
    Ok(scene::write_transforms(
        folder,
        &photos(train),
        &test.map(photos).unwrap_or_default(),
        train.bounds,
    )?)
}
