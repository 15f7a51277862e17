//! Scenes that users bring: their cameras in `transforms.json` or in a COLMAP reconstruction, from photos to a film.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::space::Space;

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

/// A COLMAP scene in `photos`: a reconstruction in text of the cameras in
/// `mine/transforms_train.json`, which [`exported`] leaves.
pub fn as_colmap(space: &Space) {
    let page: Value =
        serde_json::from_slice(&fs::read(space.path("mine/transforms_train.json")).unwrap())
            .unwrap();
    fs::create_dir_all(space.path("photos/sparse/0")).unwrap();
    fs::rename(space.path("mine/train"), space.path("photos/images")).unwrap();
    let (mut cameras, mut images, mut points) = (String::new(), String::new(), String::new());
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
        words.contains("cameras.txt: line 1: the camera model FOV is not known"),
        "{words}"
    );
}
