//! The cameras of an image set, without its pixels.

use std::path::Path;

use formats::{Bounds, Camera, openexr};

use crate::error::SchemaError;
use crate::images;
use crate::transforms::{self, Transforms};

/// From where a scene was seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Cameras {
    /// The cameras by view name, sorted.
    pub views: Vec<(String, Camera)>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
    /// Rows of the similarity that takes the scene's coordinates to those of the files that it was
    /// read from; `None` where they are the same.
    pub to_source: Option<[[f64; 4]; 4]>,
    /// Whether any of the images has alpha.
    pub alpha: bool,
}

/// Widths and heights of the views of an image set by its `transforms.json`, wherever that file
/// lies.
///
/// # Errors
/// A file that cannot be used.
pub fn sizes(page: &Path) -> Result<Vec<(u32, u32)>, SchemaError> {
    let cameras = Transforms::cameras_of(page)?.1.into_iter();
    Ok(cameras
        .map(|(_, camera)| (camera.width, camera.height))
        .collect())
}

/// The file of an image set that [`sizes`] takes.
pub const PAGE: &str = transforms::FILE;

impl Cameras {
    /// Reads those of the image set in a folder. Of the images only the headers are read.
    ///
    /// # Errors
    /// Where `transforms.json` or an image's header cannot be used.
    pub fn read(folder: &Path) -> Result<Self, SchemaError> {
        let (transforms, views) = Transforms::read(folder)?;
        let mut alpha = false;
        for (name, _) in &views {
            // Only headers: a set may hold gigabytes, and stages ask for cameras alone.
            let path = folder.join(images::file_of(name));
            // No short cut once there is alpha: a broken file must be named here.
            alpha |= openexr::has_alpha(&path)
                .map_err(|error| SchemaError::malformed(&path, error.place, error.problem))?;
        }
        Ok(Self {
            views,
            bounds: transforms.aabb,
            to_source: transforms.to_source,
            alpha,
        })
    }
}
