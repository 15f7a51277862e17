//! `docs/inputs.md` says what becomes of every format and field: each of its rows is tried.

use std::collections::BTreeSet;
use std::path::Path;

use crate::common::{SIZE, colmap, known_cameras, write_photo};
use formats::Distortion;
use glam::DQuat;
use scene::{Reader, SceneData, SceneError, Transforms};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Rows of the table whose first column is called so: its cells.
fn rows(first: &str) -> Vec<Vec<String>> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/inputs.md");
    let text = std::fs::read_to_string(page).unwrap();
    let table = text
        .lines()
        .skip_while(|line| !line.starts_with(&format!("| {first} |")));
    let cells = |line: &str| {
        let cells = line.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().replace('`', "")).collect()
    };
    let rows: Vec<Vec<String>> = table
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(cells)
        .collect();
    assert!(!rows.is_empty(), "there is no table of {first}");
    rows
}

/// Three photos with the given ending of their names and the file about them.
fn capture(ending: &str, change: impl Fn(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frame = |(i, camera): (usize, &formats::Camera)| {
        let name = format!("{i}.{ending}");
        let fresh = folder.path().join("fresh.png");
        write_photo(&fresh, SIZE, 9);
        std::fs::rename(fresh, folder.path().join(&name)).unwrap();
        let rows = camera.camera_to_world.transpose().to_cols_array_2d();
        json!({"file_path": name, "transform_matrix": rows})
    };
    let frames: Vec<Value> = known_cameras(Distortion::default())
        .iter()
        .enumerate()
        .map(frame)
        .collect();
    let mut page = json!({"fl_x": 30.0, "aabb": [[-9, -9, -30], [9, 9, -10]], "frames": frames});
    change(&mut page);
    std::fs::write(folder.path().join("transforms.json"), page.to_string()).unwrap();
    folder
}

fn read(folder: &TempDir) -> Result<SceneData, SceneError> {
    let path = folder.path().to_owned();
    Transforms {
        path,
        ..Transforms::default()
    }
    .read()
}

#[test]
fn photos_are_read_or_refused_by_format_as_the_page_says() {
    for row in rows("ending") {
        let ending = &row[0];
        let name = &row[1];
        let fate = row[2].as_str();
        // Readers look at what a file holds, so that a PNG serves under any name that is read.
        let read = read(&capture(ending, |_| {}));
        match fate {
            "read" => assert_eq!(read.unwrap().photos.len(), 3, "{ending}"),
            "refused" => {
                let said = read.unwrap_err().to_string();
                assert!(
                    said.contains(&format!("it is {name}, which is not read")),
                    "{said}"
                );
            }
            other => panic!("{ending}: what is {other}?"),
        }
    }
}

/// A value that makes sense for a field that is not read.
fn sample(field: &str) -> Value {
    match field {
        "srnerf" | "applied_transform" => json!({"some": "thing"}),
        _ => json!(0.5),
    }
}

#[test]
fn fields_are_read_ignored_or_warned_of_as_the_page_says() {
    let (read_fields, quiet) = Transforms::known_fields();
    let mut of_page = [BTreeSet::new(), BTreeSet::new()];
    for row in rows("field") {
        let field = &row[0];
        let places = &row[1];
        let fate = row[2].as_str();
        match fate {
            "read" => drop(of_page[0].insert(field.clone())),
            "ignored" => drop(of_page[1].insert(field.clone())),
            "warning" => {}
            other => panic!("{field}: what is {other}?"),
        }
        if fate == "read" {
            continue;
        }
        let field = if field == "any other" {
            "my_own_field"
        } else {
            field
        };
        for place in places.split(", ") {
            let folder = capture("png", |page| match place {
                "file" => page[field] = sample(field),
                _ => page["frames"][1][field] = sample(field),
            });
            let notes = read(&folder).unwrap().notes.join("\n");
            let names = notes.contains(&format!(
                "transforms.json: {}{field}",
                if place == "file" { "" } else { "frames." }
            ));
            assert_eq!(names, fate == "warning", "{field} of a {place}: {notes}");
            assert_eq!(notes.is_empty(), fate == "ignored", "{field}: {notes}");
        }
    }
    let of_code =
        [read_fields, quiet].map(|fields| fields.into_iter().map(str::to_owned).collect());
    assert_eq!(of_page, of_code);
}

#[test]
fn camera_models_are_read_or_refused_as_the_page_says() {
    for row in rows("camera model") {
        let model = row[0].as_str();
        let fate = row[1].as_str();
        let (parameters, plain) = match model {
            "SIMPLE_PINHOLE" => ("30 12 9", true),
            "PINHOLE" => ("30 30 12 9", true),
            "SIMPLE_RADIAL" | "SIMPLE_RADIAL_FISHEYE" => ("30 12 9 0.1", true),
            "RADIAL" | "RADIAL_FISHEYE" => ("30 12 9 0.1 0.01", true),
            "OPENCV" => ("30 30 12 9 0.1 0.01 0.001 0.001", true),
            "OPENCV_FISHEYE" => ("30 30 12 9 0.1 0.01 0.001 0.001", true),
            "FULL_OPENCV" => ("30 30 12 9 0.1 0.01 0.001 0.001 0 0.1 0 0", true),
            "FOV" => ("30 30 12 9 0", false),
            "THIN_PRISM_FISHEYE" => ("30 30 12 9 0.1 0.01 0 0 0 0 0 0", false),
            _ => ("30 30 12 9", false),
        };
        let name = if model == "any other" {
            "DIVISION"
        } else {
            model
        };
        let read = |parameters: &str| {
            let folder = reconstruction(&format!("{name} 24 18 {parameters}"));
            colmap(folder.path(), None, None)
                .read()
                .map(|scene| scene.photos.len())
        };
        match fate {
            "read" => assert!(plain && read(parameters).unwrap() == 3, "{model}"),
            "refused" => assert!(read(parameters).is_err(), "{model}"),
            _ => {
                assert!(
                    fate.starts_with("refused unless"),
                    "{model}: what is {fate}?"
                );
                assert_eq!(read(parameters).unwrap(), 3, "{model}");
                let (all_but_last, _) = parameters.rsplit_once(' ').unwrap();
                let said = read(&format!("{all_but_last} 0.5"))
                    .unwrap_err()
                    .to_string();
                assert!(said.contains("cameras.txt: line 1: its model"), "{said}");
            }
        }
    }
}

fn reconstruction(lens: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("sparse");
    std::fs::create_dir_all(&place).unwrap();
    let mut images = String::new();
    for (i, camera) in known_cameras(Distortion::default()).iter().enumerate() {
        write_photo(&folder.path().join(format!("images/{i}.png")), SIZE, 9);
        let mut pose = camera.camera_to_world;
        (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
        let (_, turn, t) = pose.inverse().to_scale_rotation_translation();
        let turn: DQuat = turn;
        images += &format!(
            "{i} {} {} {} {} {} {} {} 1 {i}.png\n\n",
            turn.w, turn.x, turn.y, turn.z, t.x, t.y, t.z
        );
    }
    std::fs::write(place.join("cameras.txt"), format!("1 {lens}\n")).unwrap();
    std::fs::write(place.join("images.txt"), images).unwrap();
    folder
}
