//! LLFF scenes broken in every way: refused by name and row.

use std::path::Path;

use scene::{Reader, SceneError};

use super::files::{known_cameras, row, write_poses, written_scene};
use crate::common::{llff, words, write_photo};

/// The error of a scene after `spoil` has been at it, with the scene's own folder left out.
fn fault(spoil: impl Fn(&Path)) -> String {
    let folder = written_scene();
    spoil(folder.path());
    let error = llff(folder.path(), None, None)
        .read()
        .expect_err("the scene is spoilt");
    words(error, folder.path())
}

fn with_rows(change: impl Fn(&mut Vec<Vec<f64>>)) -> String {
    fault(|folder| {
        let mut rows: Vec<_> = known_cameras().iter().map(row).collect();
        change(&mut rows);
        write_poses(folder, &rows);
    })
}

#[test]
fn a_missing_part_is_named_with_what_to_do() {
    let gone = llff(Path::new("no/such/scene"), None, None)
        .read()
        .unwrap_err()
        .to_string();
    assert!(
        gone.contains(
            "poses_bounds.npy: the table of camera poses is missing; point to an LLFF scene"
        ),
        "{gone}"
    );
    assert_eq!(
        fault(|folder| std::fs::remove_dir_all(folder.join("images_4")).unwrap()),
        "SCENE/images: a folder of photos is missing; put the photos into a subfolder `images` (PNG, JPEG, WebP, TIFF or EXR \
         are read)"
    );
    let folder = written_scene();
    let misspelt = llff(folder.path(), Some("image_4"), None)
        .read()
        .unwrap_err()
        .to_string();
    assert!(
        misspelt.contains("image_4: a folder of photos is missing; there is: images_4"),
        "{misspelt}"
    );
}

#[test]
fn a_broken_table_says_what_it_should_be() {
    const EXPECTED: &str = "expected an N x 17 array of little-endian f64 in C order: per photo a 3x5 pose, near and far";
    assert_eq!(
        with_rows(|rows| rows.iter_mut().for_each(|row| row.truncate(15))),
        format!("SCENE/poses_bounds.npy: the array is 3 x 15; {EXPECTED}")
    );
    let cut = fault(|folder| {
        let path = folder.join("poses_bounds.npy");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() - 5]).unwrap();
    });
    assert_eq!(
        cut,
        format!(
            "SCENE/poses_bounds.npy: shape 3x17 does not fit the 403 bytes of values that follow; {EXPECTED}"
        )
    );
}

#[test]
fn a_camera_that_cannot_be_is_named_by_its_row() {
    const POSE: &str = "SCENE/poses_bounds.npy, row 1 (counted from 0): ";
    const MEND: &str = "; run the pose estimation again or leave this photo out";
    let expect = |message: String, fault: &str| assert_eq!(message, format!("{POSE}{fault}{MEND}"));
    expect(with_rows(|rows| rows[1][3] = f64::NAN), "value 3 is NaN");
    expect(
        with_rows(|rows| rows[1][15] = 90.0),
        "near 90 and far 41 are not 0 < near < far",
    );
    expect(
        with_rows(|rows| rows[1][15] = -1.0),
        "near -1 and far 41 are not 0 < near < far",
    );
    expect(
        with_rows(|rows| rows[1][14] = 0.0),
        "width 96, height 72 and focal length 0 are not all positive",
    );
    let skewed = with_rows(|rows| rows[1][0] += 0.5);
    assert!(
        skewed.starts_with(&format!("{POSE}its rotation's columns are not orthonormal")),
        "{skewed}"
    );
    let mirrored = with_rows(|rows| {
        [1, 6, 11]
            .into_iter()
            .for_each(|i| rows[1][i] = -rows[1][i])
    });
    assert!(
        mirrored.contains("are not orthonormal axes [down, right, backwards] (off by 2.000)"),
        "{mirrored}"
    );
    let turned = with_rows(|rows| rows[1].swap(4, 9));
    assert!(
        turned.contains("photos of 72x96, the photos are 24x18: another aspect ratio"),
        "{turned}"
    );
}

#[test]
fn photos_must_be_as_many_as_poses_whole_and_of_one_size() {
    assert_eq!(
        fault(|folder| std::fs::remove_file(folder.join("images_4/photo1.png")).unwrap()),
        "SCENE/images_4 holds 2 images but SCENE/poses_bounds.npy has 3 poses; \
         they must be as many, in the same sorted order"
    );
    assert_eq!(
        fault(|folder| write_photo(&folder.join("images_4/photo2.png"), (24, 17), 0)),
        "SCENE/images_4/photo2.png is 24x17 but SCENE/images_4/photo0.png is 24x18; \
         all photos of a scene must have one size"
    );
    let cut = fault(|folder| {
        let path = folder.join("images_4/photo1.png");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert!(
        cut.starts_with(
            "SCENE/images_4/photo1.png: not a readable photo: it ends before its last row"
        ),
        "{cut}"
    );
}

#[test]
fn a_size_of_zero_is_refused() {
    let error = llff(written_scene().path(), None, Some((0, 18)))
        .read()
        .unwrap_err();
    assert!(
        matches!(error, SceneError::EmptyImage { size: (0, 18), .. }),
        "{error}"
    );
}
