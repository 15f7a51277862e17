//! The files of a COLMAP scene, written in both formats from known cameras.

use std::fmt::Write;

use formats::Camera;
use glam::DQuat;
use tempfile::TempDir;

use crate::common::{BENT, SIZE, known_cameras, write_photo};

/// World to camera as COLMAP has it: (w, x, y, z) and a translation, axes right, down, forwards.
fn world_to_camera(camera: &Camera) -> ([f64; 4], [f64; 3]) {
    let mut pose = camera.camera_to_world;
    (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
    let (_, turn, translation) = pose.inverse().to_scale_rotation_translation();
    let turn: DQuat = turn;
    ([turn.w, turn.x, turn.y, turn.z], translation.to_array())
}

/// Points at depths 10 to 30 before all cameras, each found in all photos.
fn points() -> Vec<[f64; 3]> {
    (0..40)
        .map(|i| known_cameras(BENT)[1].unproject(12.0, 9.0, 10.0 + 0.5 * f64::from(i)))
        .collect()
}

pub struct Files {
    pub cameras: Vec<u8>,
    pub images: Vec<u8>,
    pub points: Vec<u8>,
}

pub fn text() -> Files {
    let mut images = String::from("# Image list\n");
    for (i, camera) in known_cameras(BENT).iter().enumerate() {
        let ([w, x, y, z], [a, b, c]) = world_to_camera(camera);
        writeln!(
            images,
            "{} {w} {x} {y} {z} {a} {b} {c} 7 photo {i}.png\n1.5 2.5 -1",
            10 + i
        )
        .unwrap();
    }
    let mut points3d = String::new();
    for (i, [x, y, z]) in points().into_iter().enumerate() {
        writeln!(points3d, "{i} {x} {y} {z} 1 2 3 0.5 10 0 11 0 12 0").unwrap();
    }
    let cameras = format!(
        "# Camera list\n\n7 OPENCV {} {} 30 31 12.5 8.5 {} {} {} {}\n",
        SIZE.0, SIZE.1, BENT.k1, BENT.k2, BENT.p1, BENT.p2
    );
    Files {
        cameras: cameras.into(),
        images: images.into(),
        points: points3d.into(),
    }
}

pub fn binary() -> Files {
    let reals = |values: &[f64]| {
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    let count = |count: u64| count.to_le_bytes().to_vec();
    let number = |number: u32| number.to_le_bytes().to_vec();
    let lens = reals(&[30.0, 31.0, 12.5, 8.5, BENT.k1, BENT.k2, BENT.p1, BENT.p2]);
    let cameras = [
        count(1),
        number(7),
        number(4),
        count(SIZE.0.into()),
        count(SIZE.1.into()),
        lens,
    ]
    .concat();
    let mut images = count(3);
    for (i, camera) in known_cameras(BENT).iter().enumerate() {
        let (turn, translation) = world_to_camera(camera);
        let name = format!("photo {i}.png\0").into_bytes();
        let observations = [count(1), reals(&[1.5, 2.5]), count(u64::MAX)].concat();
        images.extend(
            [
                number(10 + i as u32),
                reals(&turn),
                reals(&translation),
                number(7),
                name,
                observations,
            ]
            .concat(),
        );
    }
    let mut points3d = count(40);
    for (i, point) in points().iter().enumerate() {
        let track = [10, 11, 12]
            .map(|image| [number(image), number(0)].concat())
            .concat();
        points3d.extend(
            [
                count(i as u64),
                reals(point),
                vec![1, 2, 3],
                reals(&[0.5]),
                count(3),
                track,
            ]
            .concat(),
        );
    }
    Files {
        cameras,
        images,
        points: points3d,
    }
}

pub fn written(files: &Files, extension: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    (0..3).for_each(|i| {
        write_photo(
            &folder.path().join(format!("images/photo {i}.png")),
            SIZE,
            100 + i,
        )
    });
    std::fs::create_dir_all(folder.path().join("sparse/0")).unwrap();
    for (name, bytes) in [
        ("cameras", &files.cameras),
        ("images", &files.images),
        ("points3D", &files.points),
    ] {
        std::fs::write(
            folder.path().join(format!("sparse/0/{name}.{extension}")),
            bytes,
        )
        .unwrap();
    }
    folder
}
