//! Scenes that users bring: their cameras in `transforms.json` or in a COLMAP reconstruction, from
//! photos to a film.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::space::{Said, Space};

/// Fits a field, and films it.
const FILM: &str = r#"(
    name: "film",
    stages: {
        "scene": Scene(source: SOURCE, downscale: 2, holdout: 3),
        "fit": Fit(images: "scene.train", steps: 100, samples: 2048, field: (levels: 4, log2_table: 10, occupancy_resolution: 16)),
        "fly": Render(field: "fit", cameras: "scene.train", path: Some(PATH), scale: 0.5),
        "film": Film(images: "fly", rate: 10),
    },
)"#;

/// The same with a source and a path.
fn film(space: &Space, source: &str, path: &str) {
    fs::write(
        space.path("film.ron"),
        FILM.replace("SOURCE", source).replace("PATH", path),
    )
    .unwrap();
}

/// Draws a scene of square photos, `side` pixels wide, and exports their halves as others would
/// bring them.
pub fn exported(space: &Space, world: &str, side: u32) {
    let size = format!("({side}, {side})");
    let world = format!(
        "--set=scene.source=Procedural(world: \"{world}\", views: 4, size: {size}, samples: 1)"
    );
    space.ok(&["run", "tiny.ron", &world, "--target=scene"]);
    let said = space.ok(&[
        "export",
        "transforms",
        "out/tiny/scene/train",
        "out/tiny/scene/test",
        "-o",
        "mine",
    ]);
    assert!(said.out.contains("training images"), "{}", said.out);
}

#[test]
fn a_scene_in_transforms_json_is_fitted_filmed_and_exported() {
    let space = Space::new();
    exported(&space, "object", 32);
    film(&space, "Transforms(path: \"mine\")", "Circle(frames: 3)");
    let said = space.ok(&["run", "film.ron"]);
    let is_gif = |path: &Path| path.extension() == Some(OsStr::new("gif"));
    let films = space
        .files("out")
        .into_iter()
        .filter(|(path, _)| is_gif(path))
        .collect::<Vec<_>>();
    assert_eq!(films.len(), 3, "colour, depth and opacity: {}", said.err);
    assert!(films.iter().all(|(_, gif)| gif.starts_with(b"GIF89a")));
    assert_eq!(
        space
            .files("out")
            .iter()
            .filter(|(path, _)| path.ends_with("frame_0002.png"))
            .count(),
        3
    );
    // Another path flies through the field that is there.
    let changed = space.ok(&[
        "run",
        "film.ron",
        "--set=fly.path=Some(Spiral(frames: 2, turns: 1.0))",
        "--json",
    ]);
    assert_eq!(changed.last()["ran"], json!(["film", "fly"]));

    let field = "out/film/fit/field/field.safetensors";
    let facts = space.ok(&["inspect", field, "--json"]).json()["facts"].clone();
    let part = |name: &str| facts["occupancy"][name].as_f64().unwrap();
    assert!(
        0.0 < part("occupied")
            && part("occupied") <= part("seen_by_cameras")
            && part("seen_by_cameras") <= 1.0
    );
    assert!(facts["norms"]["hash_table"].as_f64().unwrap() > 0.0);
    let level = ["--level", "0.001", "--resolution", "16"];
    let mesh = space
        .ok(&[
            &["export", "ply", field, "-o", "mesh.ply", "--json"],
            &level[..],
        ]
        .concat())
        .json();
    assert!(
        mesh["vertices"].as_u64().unwrap() > 0 && mesh["triangles"].as_u64().unwrap() > 0,
        "{mesh}"
    );
    assert!(
        fs::read(space.path("mesh.ply"))
            .unwrap()
            .starts_with(b"ply\nformat binary_little_endian 1.0\n")
    );
    let said = space.say(&["export", "ply", "nothing", "-o", "mesh.ply"]);
    assert_eq!(said.code, 2, "{}", said.err);
    let said = space.say(&["export", "transforms", "out/tiny/scene/train", "-o", "mine"]);
    assert!(
        said.code == 2 && said.err.contains("mine is there already"),
        "{}",
        said.err
    );
}

#[test]
fn decoded_images_lead_back_to_where_the_scene_came_from() {
    let space = Space::new();
    exported(&space, "object", 32);
    // As in georeferenced coordinates: far from the origin.
    for name in ["mine/transforms_train.json", "mine/transforms_test.json"] {
        let mut page: Value = serde_json::from_slice(&fs::read(space.path(name)).unwrap()).unwrap();
        for frame in page["frames"].as_array_mut().unwrap() {
            let x = frame["transform_matrix"][0][3].as_f64().unwrap();
            frame["transform_matrix"][0][3] = json!(x + 1e6);
        }
        page["aabb"] = json!([[1e6 - 2.0, -2.0, -2.0], [1e6 + 2.0, 2.0, 2.0]]);
        fs::write(space.path(name), page.to_string()).unwrap();
    }
    let pipeline = r#"(
        name: "far",
        stages: {
            "scene": Scene(source: Transforms(path: "mine"), downscale: 2, holdout: 3),
            "up": Interpolate(images: "scene.train", factor: 4),
            "encode": Encode(images: "up"),
            "decode": Decode(latents: "encode", low: "scene.train", mode: Plain, back_projection: 1),
        },
    )"#;
    fs::write(space.path("far.ron"), pipeline).unwrap();
    space.ok(&["run", "far.ron"]);
    let way_back = |folder: &str| {
        let file = space.path(folder).join("transforms.json");
        let page: Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
        page["to_source"].clone()
    };
    let scene = way_back("out/far/scene/train");
    assert!(scene[0][3].as_f64().unwrap() > 9e5, "{scene}");
    assert_eq!(way_back("out/far/decode/images"), scene);
}

/// A COLMAP scene in `photos`: a reconstruction in text of the cameras in
/// `mine/transforms_train.json`, which [`exported`] leaves.
pub fn as_colmap(space: &Space) {
    let page: Value =
        serde_json::from_slice(&fs::read(space.path("mine/transforms_train.json")).unwrap())
            .unwrap();
    fs::create_dir_all(space.path("photos/sparse/0")).unwrap();
    fs::rename(space.path("mine/train"), space.path("photos/images")).unwrap();
    let mut cameras = String::new();
    let mut images = String::new();
    let mut points = String::new();
    for (i, frame) in page["frames"].as_array().unwrap().iter().enumerate() {
        let number = |name: &str| frame[name].as_f64().unwrap();
        cameras = format!(
            "1 PINHOLE {} {} {} {} {} {}\n",
            number("w"),
            number("h"),
            number("fl_x"),
            number("fl_y"),
            number("cx"),
            number("cy")
        );
        // Cameras without turns, beside each other: this is about files, not about the picture.
        let name = frame["file_path"].as_str().unwrap().replace("./train/", "");
        images += &format!("{i} 1 0 0 0 {}.5 0 0 1 {name}.png\n\n", i);
    }
    for i in 0..20 {
        points += &format!("{i} 0 0 {} 9 9 9 0.5 0 0 1 0 2 0\n", 4 + i % 5);
    }
    for (name, text) in [
        ("cameras", cameras),
        ("images", images),
        ("points3D", points),
    ] {
        fs::write(space.path(&format!("photos/sparse/0/{name}.txt")), text).unwrap();
    }
}

#[test]
fn a_colmap_scene_is_fitted_and_filmed() {
    let space = Space::new();
    exported(&space, "object", 32);
    as_colmap(&space);
    film(&space, "Colmap(path: \"photos\")", "Spiral(frames: 2)");
    let first = space.ok(&["run", "film.ron", "--json"]);
    assert_eq!(first.last()["ran"].as_array().unwrap().len(), 4);
    assert_eq!(
        space.ok(&["run", "film.ron", "--json"]).last()["ran"],
        json!([])
    );
    // A photo that is gone is a warning; a camera that is not one is an error in its line.
    fs::remove_file(space.path("photos/images/train_003.png")).unwrap();
    let said = space.ok(&["run", "film.ron", "--json"]);
    assert!(
        said.out
            .contains("1 of 4 photos are missing, such as train_003.png"),
        "{}",
        said.out
    );
    fs::write(
        space.path("photos/sparse/0/cameras.txt"),
        "1 FOV 32 32 1 2 3 4 5\n",
    )
    .unwrap();
    let said = space.say(&["run", "film.ron"]);
    assert_eq!(said.code, 3, "{}", said.err);
    let words = said
        .err
        .replace('│', " ")
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    assert!(
        words.contains("cameras.txt: line 1: its model FOV has omega = 5"),
        "{words}"
    );
}

/// A scene in `mine` whose file is changed, and a pipeline that films it.
fn changed(change: impl Fn(&mut Value)) -> Space {
    let space = Space::new();
    exported(&space, "object", 32);
    let path = space.path("mine/transforms_train.json");
    let mut page: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut page);
    fs::write(&path, page.to_string()).unwrap();
    film(&space, "Transforms(path: \"mine\")", "Circle(frames: 2)");
    space
}

/// What was said in one line, without the terminal's frame.
fn words(said: &Said) -> String {
    let plain = said.err.replace(['│', '×'], " ");
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn warnings_of_a_scene_are_said_again_when_it_is_cached_and_by_inspect() {
    let space = changed(|page| page["shutter"] = json!(0.5));
    let warning = "warning: not used of mine/transforms_train.json: shutter";
    for round in ["computed", "cached", "remembered", "still remembered"] {
        let said = space.ok(&["run", "film.ron", "--target=scene"]);
        let count = words(&said).matches(warning).count();
        assert_eq!(count, 1, "{round}: {}", said.err);
    }
    let said = space.ok(&["inspect", "scene", "film.ron"]);
    assert!(said.out.contains(warning), "{}", said.out);
}

#[test]
fn a_camera_path_that_cannot_be_flown_is_refused_before_anything_runs() {
    let space = Space::new();
    let page = json!({"camera_path": [{"camera_to_world": [1.0], "fov": 50}]});
    fs::write(space.path("path.json"), page.to_string()).unwrap();
    let source = "Procedural(views: 3, size: (32, 24), samples: 1)";
    film(&space, source, "File(path: \"path.json\")");
    let said = space.say(&["run", "film.ron"]);
    assert_eq!(said.code, 3, "{}", said.err);
    let words = words(&said);
    assert!(
        words.contains("path.json: the file: is a camera path of nerfstudio's viewer"),
        "{words}"
    );
    assert!(!space.path("out").exists(), "nothing ran");
}

#[test]
fn a_box_that_no_camera_sees_is_refused_before_anything_runs() {
    let space = changed(|page| page["aabb"] = json!([[50, 50, 50], [51, 51, 51]]));
    let said = space.say(&["run", "film.ron"]);
    assert_eq!(said.code, 3, "{}", said.err);
    let words = words(&said);
    assert!(
        words.contains("the scene box: [50.000, 50.000, 50.000]"),
        "{words}"
    );
    assert!(words.contains("set `bounds` of the source"), "{words}");
}

#[test]
fn a_georeferenced_scene_is_exported_to_where_it_was() {
    let offset = [448_262.0, 5_411_932.0, 480.0];
    let shift = |page: &mut Value| {
        for frame in page["frames"].as_array_mut().unwrap() {
            for (row, offset) in offset.iter().enumerate() {
                let at = &mut frame["transform_matrix"][row][3];
                *at = json!(at.as_f64().unwrap() + offset);
            }
        }
        for corner in page["aabb"].as_array_mut().unwrap() {
            for (axis, offset) in offset.iter().enumerate() {
                corner[axis] = json!(corner[axis].as_f64().unwrap() + offset);
            }
        }
    };
    let space = changed(shift);
    // What the source itself sets aside has to move along.
    let test = space.path("mine/transforms_test.json");
    let mut page: Value = serde_json::from_slice(&fs::read(&test).unwrap()).unwrap();
    shift(&mut page);
    fs::write(&test, page.to_string()).unwrap();
    let said = space.ok(&["run", "film.ron", "--target=scene"]);
    assert!(words(&said).contains("far from the origin"), "{}", said.err);
    space.ok(&["export", "transforms", "out/film/scene/train", "-o", "back"]);
    let position = |file: &str| {
        let page: Value = serde_json::from_slice(&fs::read(space.path(file)).unwrap()).unwrap();
        let matrix = &page["frames"][0]["transform_matrix"];
        [0, 1, 2].map(|row| matrix[row][3].as_f64().unwrap())
    };
    let was = position("mine/transforms_train.json");
    let is = position("back/transforms_train.json");
    for (was, is) in was.iter().zip(is) {
        assert!((was - is).abs() < 1e-6, "{was} {is}");
    }
}
