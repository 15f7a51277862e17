//! Any bytes as `poses_bounds.npy` beside one photo: a scene, or one error.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use scene::{Llff, Reader};
use tempfile::TempDir;

/// A folder with the photo `images/0.png`, kept for all runs.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("images")).expect("a folder");
    image::RgbImage::new(4, 3).save(folder.path().join("images/0.png")).expect("a photo");
    folder
});

fuzz_target!(|bytes: &[u8]| {
    std::fs::write(FOLDER.path().join("poses_bounds.npy"), bytes).expect("the file can be written");
    let _ = Llff { folder: FOLDER.path().to_owned(), images: None, size: None }.read();
});
