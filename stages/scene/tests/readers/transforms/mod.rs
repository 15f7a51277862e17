//! Scenes in `transforms.json`: NeRF-synthetic, instant-ngp and nerfstudio, written, read back, and
//! broken in every way.

mod refusals;

use std::path::Path;

use formats::Distortion;
use scene::{Reader, SceneData, Transforms, write_transforms};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::common::{BENT, SIZE, known_cameras, photos, real, transforms, write_photo};

fn read(path: &Path) -> SceneData {
    transforms(path, &Transforms::default()).unwrap()
}

#[test]
fn what_is_written_comes_back_the_same() {
    let bounds = [[-1.0, -2.0, -3.0], [4.0, 5.0, 1.0 / 3.0]];
    for (bent, transparent) in [(Distortion::default(), true), (BENT, false)] {
        let train = photos(&known_cameras(bent), transparent);
        let test = photos(&known_cameras(bent)[..2], transparent);
        let folder = tempfile::tempdir().unwrap();
        write_transforms(folder.path(), &train, &test, bounds).unwrap();
        let scene = read(folder.path());
        for (was, is) in train
            .iter()
            .chain(&test)
            .zip(scene.photos.iter().chain(&scene.test))
        {
            assert_eq!((&was.name, &was.camera), (&is.name, &is.camera));
            assert!(was.pixels == is.pixels, "{}", was.name);
        }
        assert_eq!((scene.bounds, scene.notes), (bounds, vec![]));
    }
}

/// Three photos and a file about them.
fn written(file: &str, change: impl Fn(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frame = |(i, camera): (usize, &formats::Camera)| {
        write_photo(
            &folder.path().join(format!("images/{i}.png")),
            SIZE,
            100 + i as u8,
        );
        json!({"file_path": format!("images/{i}.png"), "transform_matrix": camera.camera_to_world.transpose().to_cols_array_2d()})
    };
    let cameras = known_cameras(Distortion::default());
    let frames: Vec<Value> = cameras.iter().enumerate().map(frame).collect();
    let mut page = json!({"fl_x": 30.0, "w": 24.0, "h": 18, "aabb_scale": 4, "frames": frames});
    change(&mut page);
    std::fs::write(folder.path().join(file), page.to_string()).unwrap();
    folder
}

#[test]
fn nerf_synthetic_has_a_field_of_view_splits_and_no_extensions() {
    let synthetic = |page: &mut Value| {
        *page = json!({"camera_angle_x": 0.9, "frames": page["frames"]});
        for frame in page["frames"].as_array_mut().unwrap() {
            frame["file_path"] = json!(format!(
                "./{}",
                frame["file_path"]
                    .as_str()
                    .unwrap()
                    .trim_end_matches(".png")
            ));
            frame["rotation"] = json!(0.012);
        }
    };
    let folder = written("transforms_train.json", synthetic);
    let copy = std::fs::read(folder.path().join("transforms_train.json")).unwrap();
    std::fs::write(folder.path().join("transforms_test.json"), copy).unwrap();
    let scene = read(folder.path());
    assert_eq!(
        (scene.photos.len(), scene.test.len(), scene.notes.len()),
        (3, 3, 0)
    );
    let camera = &scene.photos[0].camera;
    assert!((camera.fl_x - 12.0 / 0.45f64.tan()).abs() < 1e-12 && camera.fl_x == camera.fl_y);
    assert_eq!((camera.cx, camera.cy), (12.0, 9.0));
    assert!(
        scene
            .bounds
            .as_flattened()
            .iter()
            .all(|side| (side.abs() - 0.5 / 0.33).abs() < 1e-12)
    );
    let every = Transforms {
        test_every: 2,
        ..Default::default()
    };
    let names: Vec<_> = transforms(folder.path(), &every)
        .unwrap()
        .test
        .into_iter()
        .map(|photo| photo.name)
        .collect();
    assert_eq!(names, ["0", "2"]);
}

#[test]
fn instant_ngp_says_the_box_and_each_frame_its_own_lens() {
    let folder = written("transforms.json", |page| {
        page["offset"] = json!([0.5, 0.5, 0.0]);
        page["frames"][1]["fl_x"] = json!(60.0);
        page["frames"][1]["k1"] = json!(0.05);
        page["frames"][2]["file_path"] = json!("images/gone.png");
        page["frames"][0]["sharpness"] = json!(31.0);
        page["n_extra_learnable_dims"] = json!(16);
    });
    let scene = read(folder.path());
    assert_eq!(
        scene
            .photos
            .iter()
            .map(|photo| photo.camera.fl_y)
            .collect::<Vec<_>>(),
        [30.0, 60.0]
    );
    assert_eq!(scene.photos[1].camera.distortion.k1, 0.05);
    let half = 2.0 / 0.33;
    let expected = [[-half, -half, (0.5 - 2.0) / 0.33], [half, half, 2.5 / 0.33]];
    let close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9;
    assert!(
        scene
            .bounds
            .as_flattened()
            .iter()
            .zip(expected.as_flattened())
            .all(close),
        "{:?}",
        scene.bounds
    );
    let notes = scene.notes.join("\n");
    assert!(
        notes.contains("1 of 3 photos are missing, such as images/gone.png"),
        "{notes}"
    );
    assert!(
        notes.contains("n_extra_learnable_dims") && !notes.contains("sharpness"),
        "{notes}"
    );
    for photo in &scene.photos {
        assert!(
            0.0 < photo.camera.near
                && photo.camera.near < photo.camera.far
                && photo.camera.far < 50.0
        );
    }
}

#[test]
fn nerfstudio_names_its_splits_and_may_leave_the_box_to_us() {
    let folder = written("transforms.json", |page| {
        page["test_filenames"] = json!(["images/1.png"]);
        page["val_filenames"] = json!(["images/2.png"]);
        page["camera_model"] = json!("OPENCV");
        page.as_object_mut().unwrap().remove("aabb_scale");
    });
    let scene = read(&folder.path().join("transforms.json"));
    let names = |photos: &[scene::Photo]| {
        photos
            .iter()
            .map(|photo| photo.name.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(
        (names(&scene.photos), names(&scene.test)),
        (vec!["0".to_owned()], vec!["1".to_owned()])
    );
    assert!(
        scene
            .notes
            .iter()
            .any(|note| note.contains("gives no scene box")),
        "{:?}",
        scene.notes
    );
    let notes = scene.notes.join("; ");
    assert!(
        notes.contains("1 photos are used neither for training nor for testing"),
        "{notes}"
    );
    // The cameras look at a point 20.5 away.
    let camera = &scene.photos[0].camera;
    assert!(
        (camera.near - 2.05).abs() < 0.1 && (camera.far - 61.5).abs() < 3.0,
        "{} {}",
        camera.near,
        camera.far
    );
    let bounds = Some([[-9.0, -9.0, -30.0], [9.0, 9.0, -10.0]]);
    let told = transforms(
        folder.path(),
        &Transforms {
            bounds,
            ..Default::default()
        },
    )
    .unwrap();
    assert_eq!((Some(told.bounds), told.notes.len()), (bounds, 1));
}

#[test]
fn photos_of_another_size_keep_their_view() {
    let folder = written("transforms.json", |_| {});
    (0..3).for_each(|i| write_photo(&folder.path().join(format!("images/{i}.png")), (48, 36), 9));
    let camera = &read(folder.path()).photos[0].camera;
    assert_eq!((camera.width, camera.fl_x, camera.fl_y), (48, 60.0, 60.0));
    let small = Transforms {
        size: Some((12, 9)),
        ..Default::default()
    };
    let photo = &transforms(folder.path(), &small).unwrap().photos[0];
    assert_eq!(
        (
            photo.camera.width,
            photo.camera.fl_x,
            photo.pixels.rgb.len()
        ),
        (12, 15.0, 12 * 9 * 3)
    );
}

#[test]
fn the_digest_follows_cameras_and_photos() {
    let folder = written("transforms.json", |_| {});
    let digest = || {
        let path = folder.path().to_owned();
        let scene = Transforms {
            path,
            ..Default::default()
        };
        scene.digest().unwrap()
    };
    let first = digest();
    std::fs::write(folder.path().join("images/notes.txt"), "seen by nobody").unwrap();
    assert_eq!(digest(), first);
    write_photo(&folder.path().join("images/1.png"), SIZE, 3);
    assert_ne!(digest(), first);
}

#[test]
fn the_real_fox_stands_inside_its_box() {
    let Some(folder) = real("fox") else { return };
    let options = Transforms {
        size: Some((54, 96)),
        ..Default::default()
    };
    let scene = transforms(&folder, &options).unwrap();
    assert_eq!((scene.photos.len(), scene.test.len()), (50, 0));
    let photo = &scene.photos[0];
    assert_eq!(
        (photo.name.as_str(), photo.pixels.rgb.len()),
        ("0001", 54 * 96 * 3)
    );
    assert!((photo.camera.fl_x - 68.776).abs() < 1e-9 && photo.camera.distortion.k2 == -0.0805099);
    for photo in &scene.photos {
        let position = photo.camera.position();
        assert!(
            (0..3).all(|axis| scene.bounds[0][axis] < position[axis]
                && position[axis] < scene.bounds[1][axis])
        );
    }
}
