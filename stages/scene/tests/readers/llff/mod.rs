//! LLFF folders: written from known cameras and read back, broken in every way, and a real one
//! where it is at hand.

mod files;
mod refusals;

use std::path::Path;

use scene::{Reader, downscale, split_holdout};

use self::files::{known_cameras, row, write_poses, written_scene};
use crate::common::{SIZE, llff, write_photo};

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
