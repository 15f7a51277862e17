//! Any bytes as a photo of any format (PNG, JPEG, WebP, TIFF or EXR, by their first bytes), and as
//! its mask: a scene, or one error. The first byte says where the two part.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use scene::{Reader, Transforms};
use tempfile::TempDir;

const PAGE: &str = r#"{"camera_angle_x": 0.9, "frames": [{"file_path": "0.png", "mask_path": "mask.png", "transform_matrix":
    [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}]}"#;

/// A folder with a file about one photo, kept for all runs.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("transforms.json"), PAGE).expect("the file can be written");
    folder
});

fuzz_target!(|bytes: &[u8]| {
    let [parts, bytes @ ..] = bytes else { return };
    let (photo, mask) = bytes.split_at(bytes.len() * usize::from(*parts) / 255);
    for (name, part) in [("0.png", photo), ("mask.png", mask)] {
        std::fs::write(FOLDER.path().join(name), part).expect("the file can be written");
    }
    let path = FOLDER.path().to_owned();
    // A small size: what is tried is the reading, not what is made of it.
    let size = Some((8, 8));
    let _ = Transforms { path, size, ..Transforms::default() }.read();
});
