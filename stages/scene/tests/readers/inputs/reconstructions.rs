//! COLMAP's reconstructions.

use super::{holds, photo, ring, save};
use crate::common::{colmap, words};
use formats::Camera;
use glam::DQuat;
use image::{ImageFormat, RgbImage};
use scene::{Reader, SceneData};
use std::fmt::Write;
use tempfile::TempDir;

/// A reconstruction in text of so many cameras, with photos under `images`; the text of the images
/// may be changed.
fn reconstruction(cameras: &[Camera], lens: &str, line_of_points: bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut images = String::from("# images\n");
    let mut points = String::new();
    for (i, camera) in cameras.iter().enumerate() {
        let mut pose = camera.camera_to_world;
        (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
        let (_, turn, t) = pose.inverse().to_scale_rotation_translation();
        let turn: DQuat = turn;
        let w = turn.w;
        let x = turn.x;
        let y = turn.y;
        let z = turn.z;
        writeln!(
            images,
            "{} {w} {x} {y} {z} {} {} {} 1 {i:04}.png",
            i + 1,
            t.x,
            t.y,
            t.z
        )
        .unwrap();
        if line_of_points {
            images.push('\n');
        }
        save(
            photo(i),
            &folder.path().join(format!("images/{i:04}.png")),
            ImageFormat::Png,
        );
    }
    for i in 0..40 {
        let at = |k: u32| f64::from((i * k) % 11) / 11.0 - 0.5;
        write!(points, "{i} {} {} {} 9 9 9 0.5", at(3), at(5), at(7)).unwrap();
        (1..=cameras.len()).for_each(|image| write!(points, " {image} 0").unwrap());
        points.push('\n');
    }
    let place = folder.path().join("sparse/0");
    std::fs::create_dir_all(&place).unwrap();
    std::fs::write(place.join("cameras.txt"), format!("1 {lens}\n")).unwrap();
    std::fs::write(place.join("images.txt"), images).unwrap();
    std::fs::write(place.join("points3D.txt"), points).unwrap();
    folder
}

const PINHOLE: &str = "PINHOLE 16 12 15 15 8 6";

fn scene_of(folder: &TempDir, size: Option<(u32, u32)>) -> (SceneData, String) {
    let scene = colmap(folder.path(), None, size).read().unwrap();
    let notes = scene.notes.join("\n");
    (scene, notes)
}

#[test]
fn photos_in_folders_within_the_folder_are_read() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let images = folder.path().join("sparse/0/images.txt");
    let mut text = std::fs::read_to_string(&images).unwrap();
    for i in 0..9 {
        let name = format!("{i:04}.png");
        let within = format!("cam{}/{name}", i % 2);
        std::fs::create_dir_all(folder.path().join(format!("images/cam{}", i % 2))).unwrap();
        let old = folder.path().join("images").join(&name);
        std::fs::rename(old, folder.path().join("images").join(&within)).unwrap();
        text = text.replace(&name, &within);
    }
    std::fs::write(images, text).unwrap();
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!((scene.photos.len(), notes.as_str()), (9, ""));
}

#[test]
fn photos_that_are_not_registered_are_counted() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    (9..30).for_each(|i| {
        save(
            photo(i),
            &folder.path().join(format!("images/{i:04}.png")),
            ImageFormat::Png,
        );
    });
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(&notes, &["9 of 30 photos have a pose", "such as"]);
}

#[test]
fn records_of_one_line_are_all_read() {
    let folder = reconstruction(&ring(9), PINHOLE, false);
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["8 of 9 records of images.txt have no line of points"],
    );
    let images = folder.path().join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&images).unwrap();
    std::fs::write(
        &images,
        text.replacen("0000.png\n", "0000.png\n1.5 2.5\n", 1),
    )
    .unwrap();
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["images.txt: line 2", "X Y POINT3D_ID"],
    );
}

#[test]
fn lenses_without_distortion_or_with_all_of_opencvs_are_read() {
    for (lens, k6) in [
        ("FULL_OPENCV 16 12 15 15 8 6 0 0 0 0 0 0 0 0", 0.0),
        ("full_opencv 16 12 15 15 8 6 0.1 0 0 0 0 0.1 0 0.01", 0.01),
        ("FOV 16 12 15 15 8 6 0", 0.0),
    ] {
        let (scene, notes) = scene_of(&reconstruction(&ring(9), lens, true), None);
        assert_eq!((scene.photos.len(), notes.as_str()), (9, ""), "{lens}");
        assert_eq!(scene.photos[0].camera.distortion.k6, k6);
    }
    let fisheye = "OPENCV_FISHEYE 16 12 15 15 8 6 0.01 0 0 0";
    let (scene, _) = scene_of(&reconstruction(&ring(9), fisheye, true), None);
    assert!(scene.photos[0].camera.distortion.fisheye);
    let folder = reconstruction(&ring(9), "FOV 16 12 15 15 8 6 0.9", true);
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["cameras.txt: line 1", "omega = 0.9", "image_undistorter"],
    );
}

#[test]
fn the_folder_that_has_all_photos_is_taken() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    for i in 0..3 {
        let small = RgbImage::new(8, 6);
        save(
            small,
            &folder.path().join(format!("images_2/{i:04}.png")),
            ImageFormat::Png,
        );
    }
    let (scene, notes) = scene_of(&folder, Some((8, 6)));
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["images_2 has 3 of 9 photos and is passed over: those of images are taken"],
    );
}

#[test]
fn a_camera_far_from_all_others_is_left_out_by_name() {
    let clean = scene_of(&reconstruction(&ring(24), PINHOLE, true), None).0;
    let mut cameras = ring(24);
    cameras[7].camera_to_world.w_axis *= 100.0;
    cameras[7].camera_to_world.w_axis.w = 1.0;
    let (scene, notes) = scene_of(&reconstruction(&cameras, PINHOLE, true), None);
    assert_eq!(scene.photos.len(), 23);
    holds(
        &notes,
        &[
            "the camera of photo 0007 stands",
            "times as far away",
            "left out",
        ],
    );
    let widest = |scene: &SceneData| {
        (0..3)
            .map(|i| scene.bounds[1][i] - scene.bounds[0][i])
            .fold(0.0, f64::max)
    };
    assert!(widest(&scene) < 1.2 * widest(&clean));
}

#[test]
fn of_several_reconstructions_the_largest_is_read_and_the_others_named() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    std::fs::rename(
        folder.path().join("sparse/0"),
        folder.path().join("sparse/1"),
    )
    .unwrap();
    let small = reconstruction(&ring(3), PINHOLE, true);
    std::fs::rename(
        small.path().join("sparse/0"),
        folder.path().join("sparse/0"),
    )
    .unwrap();
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["there are 2 reconstructions (0 with 3 photos, 1 with 9 photos): 1 is read"],
    );
}

#[test]
fn points_without_tracks_are_not_called_missing() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let points = folder.path().join("sparse/0/points3D.txt");
    let text = std::fs::read_to_string(&points).unwrap();
    let without = |line: &str| line.split(' ').take(8).collect::<Vec<_>>().join(" ") + "\n";
    std::fs::write(&points, text.lines().map(without).collect::<String>()).unwrap();
    let (scene, notes) = scene_of(&folder, None);
    holds(
        &notes,
        &["they have no tracks", "all points in each photo's view"],
    );
    let camera = &scene.photos[0].camera;
    assert!(
        camera.far / camera.near < 2.0,
        "{} {}",
        camera.near,
        camera.far
    );
}

#[test]
fn a_number_that_occurs_twice_is_refused_by_line() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let images = folder.path().join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&images)
        .unwrap()
        .replace("\n3 ", "\n2 ");
    std::fs::write(&images, text).unwrap();
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["images.txt: line 6: IMAGE_ID 2 is also that of 0001.png"],
    );
}
