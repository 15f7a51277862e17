//! COLMAP scenes broken in every way: refused by name, or read.

use std::path::Path;

use proptest::prelude::*;
use scene::Reader;

use super::files::{Files, binary, text, written};
use crate::common::{any_damage, colmap, words};

/// The error for files of which one was replaced.
fn fault(extension: &str, change: impl Fn(&mut Files)) -> String {
    let mut files = if extension == "txt" { text() } else { binary() };
    change(&mut files);
    let folder = written(&files, extension);
    words(
        colmap(folder.path(), None, None)
            .read()
            .expect_err("the scene is spoilt"),
        folder.path(),
    )
}

#[test]
fn what_is_wrong_is_named_by_file_and_record() {
    let told = |message: String, parts: &[&str]| {
        parts
            .iter()
            .for_each(|part| assert!(message.contains(part), "{part} is not in: {message}"));
    };
    let overwrite = |bytes: &mut Vec<u8>, at: usize, with: &[u8]| {
        bytes[at..at + with.len()].copy_from_slice(with)
    };
    let new = fault("bin", |files| {
        overwrite(&mut files.cameras, 12, &99u32.to_le_bytes())
    });
    told(new, &["camera model number 99"]);
    let many = fault("bin", |files| {
        overwrite(&mut files.images, 0, &u64::MAX.to_le_bytes())
    });
    told(
        many,
        &[
            "images.bin: the file: 18446744073709551615 records are announced",
            "holds at most",
        ],
    );
    let cut = fault("bin", |files| files.points.truncate(300));
    told(cut, &["points3D.bin"]);
    let more = fault("bin", |files| files.points.push(0));
    told(
        more,
        &["points3D.bin: the file: 1 bytes follow the last record"],
    );
    let turn = fault("bin", |files| overwrite(&mut files.images, 12, &[0; 32]));
    told(
        turn,
        &["images.bin: photo 0.png: its rotation (0, 0, 0, 0) or translation"],
    );
    let named = |from: &'static str, to: &'static str| {
        move |files: &mut Files| {
            for bytes in [&mut files.cameras, &mut files.images, &mut files.points] {
                *bytes = String::from_utf8(bytes.clone())
                    .unwrap()
                    .replace(from, to)
                    .into_bytes();
            }
        }
    };
    told(
        fault("txt", named("OPENCV", "FOV")),
        &["cameras.txt: line 3: FOV has 5 PARAMS"],
    );
    told(
        fault("txt", named(" 31 ", " wide ")),
        &["cameras.txt: line 3: PARAMS is `wide`; expected a number"],
    );
    told(
        fault("txt", named("7 photo 1", "8 photo 1")),
        &["photo 1.png: its camera 8 is not among the cameras"],
    );
    told(
        fault("txt", named("photo", "picture")),
        &["SCENE/images/picture 0.png: the photo is missing"],
    );
    told(
        fault("txt", |files| files.images.clear()),
        &["images.txt: the file: holds no images"],
    );
    let nowhere = colmap(Path::new("no/such/scene"), None, None)
        .read()
        .unwrap_err()
        .to_string();
    told(
        nowhere,
        &[
            "no/such/scene: a COLMAP reconstruction is missing",
            "sparse/0",
        ],
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases / 3, failure_persistence: None, ..ProptestConfig::default() })]
    /// Whatever is in the files, they are read or refused by name.
    #[test]
    fn no_damage_is_more_than_an_error(
        which in 0..3usize,
        as_text in any::<bool>(),
        damages in prop::collection::vec(any_damage(), 1..4),
    ) {
        let (mut files, extension) = if as_text { (text(), "txt") } else { (binary(), "bin") };
        let file = [&mut files.cameras, &mut files.images, &mut files.points].into_iter().nth(which).unwrap();
        *file = damages.iter().fold(file.clone(), |bytes, damage| damage.to(&bytes));
        let folder = written(&files, extension);
        match colmap(folder.path(), None, None).read() {
            Ok(scene) => prop_assert!(scene.photos.iter().all(|photo| photo.camera.near < photo.camera.far)),
            Err(error) => prop_assert!(words(error, folder.path()).contains("SCENE")),
        }
    }
}
