//! COLMAP reconstructions: written in both formats from known cameras, read back, broken in every
//! way, and a real one where it is at hand.
#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod common;

use std::fmt::Write;
use std::path::Path;

use common::{BENT, SIZE, any_damage, colmap, known_cameras, llff, real, words, write_photo};
use formats::Camera;
use glam::{DMat4, DQuat, DVec3};
use proptest::prelude::*;
use scene::{Photo, Reader};
use tempfile::TempDir;

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

struct Files {
    cameras: Vec<u8>,
    images: Vec<u8>,
    points: Vec<u8>,
}

fn text() -> Files {
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

fn binary() -> Files {
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

fn written(files: &Files, extension: &str) -> TempDir {
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

/// Whether what one camera sees at some pixel and depth, the next sees where it always did, up to
/// one scale.
fn assert_similar(known: &[Camera], read: &[Camera], pixels: f64) {
    let scale = read[0].position().distance(read[1].position())
        / known[0].position().distance(known[1].position());
    for i in 0..known.len() {
        let j = (i + 1) % known.len();
        let w = f64::from(known[i].width);
        let h = f64::from(known[i].height);
        for (px, py) in [(0.2 * w, 0.3 * h), (0.7 * w, 0.6 * h)] {
            let depth = 0.5 * (known[i].near + known[i].far);
            let was = known[j].project(known[i].unproject(px, py, depth)).unwrap();
            let is = read[j]
                .project(read[i].unproject(px, py, depth * scale))
                .unwrap();
            let off = (was[0] - is[0]).hypot(was[1] - is[1]);
            assert!(off < pixels, "{i}: {off} pixels off: {was:?} {is:?}");
        }
    }
}

fn cameras(photos: &[Photo]) -> Vec<Camera> {
    photos.iter().map(|photo| photo.camera).collect()
}

#[test]
fn cameras_that_were_written_come_back_up_to_one_similarity() {
    for (files, extension) in [(text(), "txt"), (binary(), "bin")] {
        let scene = {
            let folder = written(&files, extension);
            colmap(folder.path(), None, None).read().unwrap()
        };
        assert_eq!(
            scene
                .photos
                .iter()
                .map(|photo| photo.name.as_str())
                .collect::<Vec<_>>(),
            ["photo 0", "photo 1", "photo 2"]
        );
        assert_similar(&known_cameras(BENT), &cameras(&scene.photos), 1e-6);
        let camera = &scene.photos[1].camera;
        assert_eq!(
            (camera.fl_x, camera.fl_y, camera.cx, camera.cy),
            (30.0, 31.0, 12.5, 8.5)
        );
        assert_eq!(camera.distortion, BENT);
        // The middle camera's points lie from 10 to 29.5; the nearest of all is at depth 1 now.
        assert!(
            (camera.far / camera.near - 29.5 / 10.0).abs() < 0.02,
            "{} {}",
            camera.near,
            camera.far
        );
        let nearest = scene
            .photos
            .iter()
            .map(|photo| photo.camera.near)
            .fold(f64::INFINITY, f64::min);
        assert!((nearest - 1.0).abs() < 1e-12 && scene.notes.is_empty());
    }
}

#[test]
fn without_points_or_some_photos_the_rest_is_read_and_noted() {
    let folder = written(&binary(), "bin");
    std::fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    std::fs::remove_file(folder.path().join("images/photo 1.png")).unwrap();
    std::fs::write(
        folder.path().join("sparse/0/rigs.bin"),
        "what newer versions add",
    )
    .unwrap();
    let scene = colmap(folder.path(), None, None).read().unwrap();
    assert_eq!(scene.photos.len(), 2);
    let notes = scene.notes.join("\n");
    assert!(
        notes.contains("1 of 3 photos are missing, such as photo 1.png"),
        "{notes}"
    );
    assert!(notes.contains("enough sparse points"), "{notes}");
    assert!(notes.contains("rigs.bin: not read"), "{notes}");
}

#[test]
fn the_digest_follows_the_reconstruction_and_the_photos() {
    let folder = written(&binary(), "bin");
    let digest = || colmap(folder.path(), None, None).digest().unwrap();
    let first = digest();
    std::fs::write(folder.path().join("sparse/0/rigs.bin"), "not needed").unwrap();
    assert_eq!(digest(), first);
    write_photo(&folder.path().join("images/photo 0.png"), SIZE, 7);
    assert_ne!(digest(), first);
}

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

/// LLFF's poses of fern were found in another reconstruction, of photos four times as large.
#[test]
fn the_real_fern_is_the_same_scene_as_its_llff_poses() {
    let Some(folder) = real("llff/fern") else {
        return;
    };
    let size = Some((126, 94));
    let ours = colmap(&folder, None, size).read().unwrap();
    let theirs = llff(&folder, None, size).read().unwrap();
    assert_eq!(ours.photos.len(), 20);
    let a = cameras(&theirs.photos);
    let b = cameras(&ours.photos);
    let fit = Similarity::between(&a, &b);
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        assert_eq!(theirs.photos[i].name, ours.photos[i].name);
        let off = fit.apply(a.position()).distance(b.position());
        let turned = (fit.turn * a.camera_to_world.z_axis.truncate())
            .angle_between(b.camera_to_world.z_axis.truncate());
        println!(
            "{}: {off:.4} off, turned by {:.2} degrees; near {:.3} {:.3}, far {:.2} {:.2}",
            ours.photos[i].name,
            turned.to_degrees(),
            a.near * fit.scale,
            b.near,
            a.far * fit.scale,
            b.far
        );
        assert!(
            off < 0.02 && turned < 0.02,
            "camera {i} is {off} off and turned by {turned}"
        );
        assert!(
            (a.near * fit.scale / b.near - 1.0).abs() < 0.25
                && (a.far * fit.scale / b.far - 1.0).abs() < 0.25
        );
        assert!(
            (a.fl_x / b.fl_x - 1.0).abs() < 0.03,
            "{} {}",
            a.fl_x,
            b.fl_x
        );
    }
}

/// Turns, moves and scales the world.
struct Similarity {
    turn: glam::DMat3,
    scale: f64,
    from: DVec3,
    to: DVec3,
}

impl Similarity {
    /// The one that takes cameras to cameras: by the mean position, the mean turn, and the spread.
    fn between(a: &[Camera], b: &[Camera]) -> Similarity {
        let mean = |cameras: &[Camera]| {
            cameras.iter().map(Camera::position).sum::<DVec3>() / cameras.len() as f64
        };
        let from = mean(a);
        let to = mean(b);
        let spread = |cameras: &[Camera], mean: DVec3| {
            cameras
                .iter()
                .map(|camera| camera.position().distance_squared(mean))
                .sum::<f64>()
                .sqrt()
        };
        let turn = |(a, b): (&Camera, &Camera)| -> DMat4 {
            b.camera_to_world * a.camera_to_world.inverse()
        };
        let sum = a
            .iter()
            .zip(b)
            .map(turn)
            .fold(DMat4::ZERO, |sum, turn| sum + turn);
        let axes = glam::DMat3::from_mat4(sum);
        let x = axes.x_axis.normalize();
        let y = (axes.y_axis - x * x.dot(axes.y_axis)).normalize();
        Similarity {
            turn: glam::DMat3::from_cols(x, y, x.cross(y)),
            scale: spread(b, to) / spread(a, from),
            from,
            to,
        }
    }

    fn apply(&self, point: DVec3) -> DVec3 {
        self.to + self.scale * (self.turn * (point - self.from))
    }
}
