//! Image sets in the layouts of other programs, read back by our own readers. Whether those
//! programs' own libraries take them is tried by `tests/exports`.

use std::fs;

use formats::Camera;
use glam::DMat4;
use scene::{Colmap, Photo, Reader, SceneData, Transforms};
use serde_json::{Value, json};

use crate::space::{Said, Space};

/// A drawn scene whose training photos have a lens, as `lens` changes each frame's fields.
fn space(lens: impl Fn(&mut Value)) -> Space {
    let space = Space::new();
    space.ok(&["run", "tiny.ron", "--target=up"]);
    let path = space.path("out/tiny/scene/train/transforms.json");
    let mut page = page(&space, &format!("{TRAIN}/transforms.json"));
    // The store keeps its own copy: what is shown may be a link to it.
    fs::remove_file(&path).unwrap();
    let frames = page["frames"].as_array_mut().unwrap();
    frames.iter_mut().for_each(&lens);
    fs::write(&path, page.to_string()).unwrap();
    space
}

fn plain() -> Space {
    space(|_| {})
}

const TRAIN: &str = "out/tiny/scene/train";
const TEST: &str = "out/tiny/scene/test_low";

fn read(reader: &dyn Reader) -> SceneData {
    reader.read().unwrap()
}

fn photos(space: &Space, folder: &str) -> SceneData {
    read(&Transforms {
        path: space.path(folder),
        ..Transforms::default()
    })
}

/// The same photos and lenses, and poses within `tolerance` once both stand in the coordinates of
/// their files.
fn assert_same(ours: &[Photo], to_source: DMat4, theirs: &[Photo], tolerance: f64) {
    let names = |photos: &[Photo]| photos.iter().map(|p| p.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(ours), names(theirs));
    for (our, their) in ours.iter().zip(theirs) {
        let lens = |camera: &Camera| Camera {
            camera_to_world: DMat4::IDENTITY,
            near: 1.0,
            far: 2.0,
            ..*camera
        };
        assert_eq!(lens(&our.camera), lens(&their.camera));
        let scale = to_source.x_axis.length();
        let mut moved = to_source * our.camera.camera_to_world;
        for axis in [&mut moved.x_axis, &mut moved.y_axis, &mut moved.z_axis] {
            *axis /= scale;
        }
        let apart = moved
            .to_cols_array()
            .into_iter()
            .zip(their.camera.camera_to_world.to_cols_array());
        let apart = apart.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < tolerance, "{}: {apart}", our.name);
        let worst = our
            .pixels
            .rgb
            .iter()
            .zip(&their.pixels.rgb)
            .map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f32::max) < 0.003, "8 bits of {}", our.name);
    }
}

#[test]
fn colmap_holds_lenses_and_poses_to_the_last_digits() {
    for lens in [
        json!({}),
        json!({"k1": 0.05, "k2": -0.01, "p1": 0.001}),
        json!({"k1": 0.05, "k3": 0.002, "k5": 0.01, "camera_model": "FULL_OPENCV"}),
        json!({"k1": 0.05, "k4": 0.001, "is_fisheye": true}),
    ] {
        let space = space(|frame| set_lens(frame, &lens));
        let said = space.ok(&["export", "colmap", TRAIN, TEST, "-o", "colmap"]);
        assert!(
            said.err.contains("give a field by --points"),
            "{}",
            said.err
        );
        let scene = read(&Colmap {
            folder: space.path("colmap"),
            ..Colmap::default()
        });
        let train = photos(&space, TRAIN);
        let test = photos(&space, TEST);
        let mut photos = [train.photos, test.photos].concat();
        photos.sort_by(|a, b| a.name.cmp(&b.name));
        assert_same(&scene.photos, scene.to_source, &photos, 1e-12);
        let names = fs::read_to_string(space.path("colmap/sparse/0/test.txt")).unwrap();
        assert_eq!(names, "view_000.png\nview_002.png\n");
    }
}

fn set_lens(frame: &mut Value, lens: &Value) {
    for (name, value) in lens.as_object().unwrap() {
        frame[name] = value.clone();
    }
}

fn page(space: &Space, file: &str) -> Value {
    serde_json::from_slice(&fs::read(space.path(file)).unwrap()).unwrap()
}

#[test]
fn transforms_hold_cameras_boxes_and_splits_exactly() {
    let space = plain();
    let train = photos(&space, TRAIN);
    let test = photos(&space, TEST);
    for layout in ["nerfstudio", "brush", "instant-ngp"] {
        space.ok(&["export", layout, TRAIN, TEST, "-o", layout]);
        let scene = photos(&space, layout);
        assert_same(&scene.photos, scene.to_source, &train.photos, 1e-15);
        assert_eq!(scene.bounds, train.bounds, "{layout}");
        let held_out = match layout {
            "instant-ngp" => photos(&space, "instant-ngp/test").photos,
            _ => scene.test,
        };
        assert_same(&held_out, DMat4::IDENTITY, &test.photos, 1e-15);
        let range = |photos: &[Photo]| {
            photos
                .iter()
                .map(|p| (p.camera.near, p.camera.far))
                .collect::<Vec<_>>()
        };
        assert_eq!(range(&scene.photos), range(&train.photos), "{layout}");
    }
    let page = page(&space, "instant-ngp/transforms.json");
    let number = |value: &Value| value.as_f64().unwrap();
    for axis in 0..3 {
        for corner in train.bounds {
            let in_cube = corner[axis] * number(&page["scale"]) + number(&page["offset"][axis]);
            assert!((-1e-9..=1.0 + 1e-9).contains(&in_cube), "{in_cube}");
        }
    }
}

#[test]
fn intrinsics_stand_in_each_frame_where_they_differ() {
    let space = plain();
    space.ok(&["export", "nerfstudio", TEST, "-o", "same"]);
    let same = page(&space, "same/transforms.json");
    assert!(same["cx"].is_number() && same["frames"][0]["cx"].is_null());
    let path = space.path(TEST).join("transforms.json");
    let mut changed = page(&space, &format!("{TEST}/transforms.json"));
    changed["frames"][0]["cx"] = json!(7.25);
    fs::remove_file(&path).unwrap();
    fs::write(&path, changed.to_string()).unwrap();
    space.ok(&["export", "nerfstudio", TEST, "-o", "differ"]);
    let differ = page(&space, "differ/transforms.json");
    assert!(differ["cx"].is_null() && differ["camera_model"] == "OPENCV");
    assert_eq!(differ["frames"][0]["cx"], 7.25);
    assert_eq!(differ["frames"][1]["cx"], same["cx"]);
}

#[test]
fn what_a_program_does_not_know_is_refused_and_nothing_is_left() {
    let space = space(|frame| set_lens(frame, &json!({"k1": 0.05, "k3": 0.002})));
    let refused = |arguments: &[&str], what: &str| {
        let said: Said = space.say(&[&["export"], arguments].concat());
        assert_eq!(said.code, 2, "{arguments:?}");
        assert!(said.err.contains(what), "{arguments:?}: {}", said.err);
        assert!(!space.path("there").exists());
    };
    refused(
        &["brush", TRAIN, "-o", "there"],
        "k3 = 0.002, which brush cannot hold",
    );
    refused(
        &["instant-ngp", TRAIN, "-o", "there"],
        "export colmap holds every lens",
    );
    let exr = ["nerfstudio", TRAIN, "-o", "there", "--images", "exr"];
    refused(&exr, "EXR files, which nerfstudio cannot hold");
    refused(
        &["colmap", "nothing", "-o", "there"],
        "give the folder of an image set",
    );
    space.ok(&["export", "nerfstudio", TRAIN, "-o", "there"]);
    let said = space.say(&["export", "nerfstudio", TRAIN, "-o", "there"]);
    assert!(said.err.contains("there is there already"), "{}", said.err);
}

#[test]
fn exr_files_are_taken_as_they_are() {
    let space = plain();
    space.ok(&[
        "export",
        "instant-ngp",
        TRAIN,
        "-o",
        "ngp",
        "--images",
        "exr",
    ]);
    let file = "view_001.exr";
    let [ours, theirs] = [TRAIN, "ngp/images"]
        .map(|folder| space.files(folder)[file.as_ref() as &std::path::Path].clone());
    assert_eq!(ours, theirs);
    let scene = photos(&space, "ngp");
    assert_same(
        &scene.photos,
        DMat4::IDENTITY,
        &photos(&space, TRAIN).photos,
        1e-15,
    );
}
