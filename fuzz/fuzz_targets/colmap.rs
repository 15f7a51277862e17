//! Any bytes as the three files of a COLMAP reconstruction, binary or text, beside one photo: a
//! scene, or one error. The first byte says which format, the next two where the files part.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use scene::{Colmap, Reader};
use tempfile::TempDir;

/// A folder for each format with the photo `images/0.png`, kept for all runs.
static FOLDERS: LazyLock<[TempDir; 2]> = LazyLock::new(|| {
    [(), ()].map(|()| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::create_dir_all(folder.path().join("sparse/0")).expect("folders");
        std::fs::create_dir_all(folder.path().join("images")).expect("folders");
        image::RgbImage::new(4, 3).save(folder.path().join("images/0.png")).expect("a photo");
        folder
    })
});

fuzz_target!(|bytes: &[u8]| {
    let [format, first, second, rest @ ..] = bytes else { return };
    let (which, extension) = if format % 2 == 0 { (0, "bin") } else { (1, "txt") };
    let folder = FOLDERS[which].path();
    let (cameras, rest) = rest.split_at(rest.len().min((*first).into()));
    let (images, points) = rest.split_at(rest.len().min((*second).into()));
    for (name, part) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::write(folder.join(format!("sparse/0/{name}.{extension}")), part).expect("the file can be written");
    }
    let _ = Colmap { folder: folder.to_owned(), images: None, size: None }.read();
});
