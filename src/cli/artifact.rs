//! Artifacts that a command line names. Knows no store.

use std::path::Path;

use artifacts_schema::{Artifact, ImageSet};
use nerf::Field;
use stages::convert;

use super::error::Error;
use crate::content::lineage::Told;

/// A field by its file, its folder, or the folder of the stage that made it.
pub fn field(path: &Path) -> Result<Field, Error> {
    let refuse =
        |problem: String| Error::usage(problem, "give a field: field.safetensors, or its folder");
    let told = Told::read(path).map_err(refuse)?;
    convert::field(told.field).map_err(|error| refuse(error.to_string()))
}

/// An image set by its folder.
pub fn images(folder: &Path) -> Result<ImageSet, Error> {
    ImageSet::read(folder).map_err(|error| {
        Error::usage(
            error.to_string(),
            "give the folder of an image set, with transforms.json and EXR files",
        )
    })
}
