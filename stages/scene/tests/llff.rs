//! LLFF folders: written from known cameras and read back, broken in every way, and a real one
//! where it is at hand.
#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod common;

use std::path::Path;

use common::llff;
use formats::{Camera, Distortion};
use glam::DVec3;
use npyz::WriterBuilder;
use scene::{Reader, SceneError, downscale, split_holdout};
use tempfile::TempDir;

const SIZE: (u32, u32) = (24, 18);

fn known_cameras() -> Vec<Camera> {
    let target = DVec3::new(1.0, 2.0, -20.0);
    let positions = [
        DVec3::new(-2.0, 2.5, 1.0),
        DVec3::new(1.0, 1.5, 0.0),
        DVec3::new(4.0, 2.2, 0.5),
    ];
    let camera = |(i, position): (usize, DVec3)| Camera {
        width: SIZE.0,
        height: SIZE.1,
        fl_x: 30.0,
        fl_y: 30.0,
        cx: 12.0,
        cy: 9.0,
        distortion: Distortion::default(),
        camera_to_world: Camera::look_at(position, target),
        near: 10.0 + i as f64,
        far: 40.0 + i as f64,
    };
    positions.into_iter().enumerate().map(camera).collect()
}

/// A camera as LLFF stores it: axes [down, right, backwards], sizes of photos four times as large.
fn row(camera: &Camera) -> Vec<f64> {
    let pose = camera.camera_to_world;
    let right = pose.x_axis;
    let up = pose.y_axis;
    let back = pose.z_axis;
    let at = pose.w_axis;
    let full = [
        4.0 * f64::from(camera.height),
        4.0 * f64::from(camera.width),
        4.0 * camera.fl_x,
    ];
    let rows = (0..3).flat_map(|i| [-up[i], right[i], back[i], at[i], full[i]]);
    rows.chain([camera.near, camera.far]).collect()
}

fn write_poses(folder: &Path, rows: &[Vec<f64>]) {
    let shape = [rows.len() as u64, rows.first().map_or(17, Vec::len) as u64];
    let file = std::fs::File::create(folder.join("poses_bounds.npy")).unwrap();
    let mut npy = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&shape)
        .writer(file)
        .begin_nd()
        .unwrap();
    npy.extend(rows.iter().flatten()).unwrap();
    npy.finish().unwrap();
}

fn write_photo(path: &Path, (width, height): (u32, u32), red: u8) {
    image::RgbImage::from_pixel(width, height, image::Rgb([red, 10, 20]))
        .save(path)
        .unwrap();
}

fn written_scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_poses(
        folder.path(),
        &known_cameras().iter().map(row).collect::<Vec<_>>(),
    );
    std::fs::create_dir(folder.path().join("images_4")).unwrap();
    for i in [2, 0, 1] {
        write_photo(
            &folder.path().join(format!("images_4/photo{i}.png")),
            SIZE,
            100 + i,
        );
    }
    folder
}

#[test]
fn cameras_that_were_written_come_back_up_to_one_similarity() {
    let folder = written_scene();
    let scene = llff(folder.path(), None, None).read().unwrap();
    let known = known_cameras();
    let read = scene.photos;
    assert_eq!(
        read.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(),
        ["photo0", "photo1", "photo2"]
    );
    assert_eq!(
        read.iter()
            .map(|p| (p.pixels.rgb[0] * 255.0).round())
            .collect::<Vec<_>>(),
        [100.0, 101.0, 102.0]
    );
    for i in 0..3 {
        let a = &known[i];
        let b = &read[i].camera;
        assert_eq!(
            (a.width, a.height, a.cx, a.cy),
            (b.width, b.height, b.cx, b.cy)
        );
        assert!((a.fl_x - b.fl_x).abs() < 1e-12 && (a.fl_y - b.fl_y).abs() < 1e-12);
        assert!((b.near - a.near / 10.0).abs() < 1e-12 && (b.far - a.far / 10.0).abs() < 1e-12);
        // What one camera sees at some pixel and depth, the next camera sees where it always did.
        let j = (i + 1) % 3;
        let was = known[j].project(a.unproject(5.0, 4.0, 20.0)).unwrap();
        let is = read[j].camera.project(b.unproject(5.0, 4.0, 2.0)).unwrap();
        for (was, is) in was.into_iter().zip([is[0], is[1], is[2] * 10.0]) {
            assert!((was - is).abs() < 1e-9, "{was} {is}");
        }
    }
}

#[test]
fn the_box_holds_every_frustum_and_touches_them() {
    let scene = {
        let folder = written_scene();
        llff(folder.path(), None, None).read().unwrap()
    };
    let corners: Vec<_> = scene
        .photos
        .iter()
        .flat_map(|p| p.camera.frustum_corners())
        .collect();
    for axis in 0..3 {
        let low = corners
            .iter()
            .map(|c| c[axis])
            .fold(f64::INFINITY, f64::min);
        let high = corners
            .iter()
            .map(|c| c[axis])
            .fold(f64::NEG_INFINITY, f64::max);
        assert_eq!([scene.bounds[0][axis], scene.bounds[1][axis]], [low, high]);
    }
    assert!(
        scene.bounds[1][2] < 0.0,
        "forward-facing cameras look along -z"
    );
}

#[test]
fn a_size_that_is_asked_for_scales_photos_and_intrinsics_per_axis() {
    let scene = {
        let folder = written_scene();
        llff(folder.path(), None, Some((12, 6))).read().unwrap()
    };
    let photo = &scene.photos[1];
    assert_eq!(
        (
            photo.camera.width,
            photo.camera.height,
            photo.pixels.rgb.len()
        ),
        (12, 6, 12 * 6 * 3)
    );
    assert_eq!(
        (photo.camera.fl_x, photo.camera.fl_y, photo.camera.cy),
        (15.0, 10.0, 3.0)
    );
}

#[test]
fn the_smallest_folder_that_is_large_enough_is_chosen() {
    let folder = written_scene();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    for i in 0..3 {
        write_photo(
            &folder.path().join(format!("images/full{i}.png")),
            (96, 72),
            9,
        );
    }
    let first_name = |images, size| {
        llff(folder.path(), images, size).read().unwrap().photos[0]
            .name
            .clone()
    };
    assert_eq!(first_name(None, Some((24, 18))), "photo0");
    assert_eq!(first_name(None, Some((25, 18))), "full0");
    assert_eq!(first_name(None, None), "full0");
    assert_eq!(
        first_name(Some("images_4"), Some((25, 18))),
        "photo0",
        "a name given wins"
    );
}

#[test]
fn the_digest_follows_what_is_read_and_nothing_else() {
    let folder = written_scene();
    let digest = || llff(folder.path(), None, Some(SIZE)).digest().unwrap();
    let first = digest();
    std::fs::write(folder.path().join("notes.txt"), "seen by nobody").unwrap();
    assert_eq!(digest(), first);
    std::fs::rename(
        folder.path().join("images_4/photo2.png"),
        folder.path().join("images_4/photo3.png"),
    )
    .unwrap();
    let renamed = digest();
    assert_ne!(renamed, first, "names become view names");
    write_photo(&folder.path().join("images_4/photo3.png"), SIZE, 7);
    let repainted = digest();
    assert_ne!(repainted, renamed);
    write_poses(
        folder.path(),
        &known_cameras().iter().rev().map(row).collect::<Vec<_>>(),
    );
    assert_ne!(digest(), repainted);
}

/// The error of a scene after `spoil` has been at it, with the scene's own folder left out.
fn fault(spoil: impl Fn(&Path)) -> String {
    let folder = written_scene();
    spoil(folder.path());
    let error = llff(folder.path(), None, None)
        .read()
        .expect_err("the scene is spoilt");
    error
        .to_string()
        .replace(&format!("{}", folder.path().display()), "SCENE")
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

#[test]
fn the_real_fern_reads_as_its_table_says() {
    let Some(data) = std::env::var_os("SRNERF_TEST_DATA") else {
        eprintln!("SRNERF_TEST_DATA is not set: skipped");
        return;
    };
    let scene = llff(&Path::new(&data).join("llff/fern"), None, Some((252, 189)))
        .read()
        .unwrap();
    assert_eq!(scene.photos.len(), 20);
    let camera = &scene.photos[0].camera;
    assert_eq!((camera.width, camera.height), (252, 189));
    assert!(
        (camera.fl_x - 3260.526 / 16.0).abs() < 1e-3,
        "{}",
        camera.fl_x
    );
    let nearest = scene
        .photos
        .iter()
        .map(|p| p.camera.near)
        .fold(f64::INFINITY, f64::min);
    assert!((nearest - 1.0).abs() < 1e-12);
    assert!(
        scene
            .photos
            .iter()
            .all(|p| (3.5..4.8).contains(&p.camera.far)),
        "17..80 scaled by the nearest, 16.985"
    );
    let size = |axis: usize| scene.bounds[1][axis] - scene.bounds[0][axis];
    assert!(
        (4.0..12.0).contains(&size(0)) && (3.0..9.0).contains(&size(1)),
        "{:?}",
        scene.bounds
    );
    let (train, test) = split_holdout(scene.photos, 8);
    assert_eq!((train.len(), test.len()), (17, 3));
    let low = downscale(&test[1], 4, Default::default()).unwrap();
    assert_eq!(
        (low.name.as_str(), low.camera.width, low.camera.height),
        ("image008", 63, 47)
    );
}
