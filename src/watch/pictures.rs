//! The pictures that a stage has left in its folder, as a browser shows them. Knows nothing of the
//! run.

use std::fs;
use std::path::Path;

use artifacts_schema::{StoredImages, View};
use serde::Serialize;

use crate::view::picture::{self, ImageFormat};

/// Of one output, so many are shown.
const MOST: usize = 6;

/// A picture.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Listed {
    /// The output that it is of.
    pub output: String,
    pub file: String,
}

/// The first pictures of each output in the folder of a stage, sorted.
pub fn list(stage: &Path) -> Vec<Listed> {
    let mut all = Vec::new();
    for output in names(stage) {
        let files = names(&stage.join(&output)).into_iter();
        let pictures = files.filter(|file| file.ends_with(".png") || file.ends_with(".exr"));
        all.extend(pictures.take(MOST).map(|file| Listed {
            output: output.clone(),
            file,
        }));
    }
    all
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    names
}

/// A picture as a PNG of 8 bits, sRGB; `None` where there is none.
pub fn png(path: &Path) -> Option<Vec<u8>> {
    // Browsers show these as they are. EXR files they do not know.
    if path.extension()? == "png" {
        return fs::read(path).ok();
    }
    let name = path.file_stem()?.to_str()?;
    // Only an EXR file that its image set names is shown, and with the camera that it has there.
    let images = StoredImages::open(path.parent()?).ok()?;
    let (_, camera) = images.cameras()[images.find(name)?];
    let view = View::from_exr(path, name, camera).ok()?;
    let size = [camera.width, camera.height];
    picture::encode(&picture::photo(&view), size, ImageFormat::Png).ok()
}
