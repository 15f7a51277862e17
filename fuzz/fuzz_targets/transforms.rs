//! Any bytes as a `transforms.json` beside one photo: a scene, or one error.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use scene::{Reader, Transforms};
use tempfile::TempDir;

/// A folder with the photo `0.png`, kept for all runs.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    image::RgbImage::new(4, 3).save(folder.path().join("0.png")).expect("a photo");
    folder
});

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.path().join("transforms.json");
    std::fs::write(&path, bytes).expect("the file can be written");
    let _ = Transforms { path, ..Transforms::default() }.read();
});
