//! What `view` shows: the pictures of `Render`, the photos of the scene, the newest camera first.
//! `tests/view` clicks through its page.

use std::fs;
use std::io::{Read, Write};

use artifacts_schema::{Artifact, ImageSet};
use serde_json::{Value, json};
use stages::convert;

use crate::space::Space;
use crate::viewer::{Answer, FIELDS, Frame, Viewer, fields, frames, look, request};

/// The picture with one ray for each of its pixels: 8-bit sRGB.
fn whole(frames: &[Frame]) -> image::RgbImage {
    let frame = frames
        .iter()
        .find(|frame| frame.head["part"] == 1 && frame.head["rays"] == 1);
    let frame = frame.unwrap();
    assert_eq!(frame.head["type"], "image/png");
    image::load_from_memory(&frame.file).unwrap().to_rgb8()
}

/// A picture of an image set, as it is shown.
fn shown(space: &Space, folder: &str, view: usize) -> image::RgbImage {
    let set = ImageSet::read(&space.path(folder)).unwrap();
    let view = &set.views[view];
    let bytes = convert::srgb(view)
        .into_iter()
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    image::RgbImage::from_raw(view.camera.width, view.camera.height, bytes).unwrap()
}

#[test]
fn the_newest_camera_wins() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    let path = format!("/{}/look", viewer.token);
    let mut older = viewer.connect();
    let large = request(
        "POST",
        &path,
        &[("Host", &viewer.host)],
        &look(0, 2560).to_string(),
    );
    older.write_all(large.as_bytes()).unwrap();
    // It is at work once its answer has begun.
    let mut first = [0; 1];
    older.read_exact(&mut first).unwrap();
    let newer = viewer.frames(&look(1, 32));
    assert_eq!(newer.last().unwrap().head["rays"], 2, "all levels");
    let mut rest = first.to_vec();
    older.read_to_end(&mut rest).unwrap();
    let overtaken = frames(&Answer::read(&rest).body);
    assert!(overtaken.iter().all(|frame| frame.head["rays"] == 1));
}

#[test]
fn pictures_are_those_of_render_and_photos_those_of_the_scene() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    assert_eq!(
        viewer.said["fields"],
        json!(["sync", "fit"]),
        "the last, and what it began with"
    );
    assert_eq!(viewer.said["photos"], 3);
    let seen = viewer.frames(&look(1, 32));
    let formats: Vec<(&Value, &Value, &Value)> = seen
        .iter()
        .map(|frame| {
            (
                &frame.head["part"],
                &frame.head["rays"],
                &frame.head["type"],
            )
        })
        .collect();
    assert_eq!(
        formats[formats.len() - 2..],
        [
            (&json!(1), &json!(1), &json!("image/png")),
            (&json!(1), &json!(2), &json!("image/png"))
        ]
    );
    let seen = whole(&seen);
    assert_eq!(seen, shown(&space, "out/fields/render/images", 1));
    let photo = viewer.ask("GET", "photo/1", "");
    assert_eq!(
        image::load_from_memory(&photo.body).unwrap().to_rgb8(),
        shown(&space, "out/fields/scene/train", 1)
    );
    // The other field, and what else can be seen of one.
    let mut pictures = vec![seen];
    for (field, show) in [(1, "color"), (0, "depth"), (0, "opacity"), (0, "normals")] {
        let mut look = look(1, 32);
        look["panes"] = json!([{"field": field, "show": show}]);
        pictures.push(whole(&viewer.frames(&look)));
        let (color, others) = pictures.split_first().unwrap();
        assert!(!others.contains(color), "{show}");
    }
    let mut moving = look(1, 32);
    moving["moving"] = json!(true);
    let moving = viewer.frames(&moving);
    assert_eq!(moving.len(), 1);
    assert_eq!(moving[0].head["type"], "image/jpeg");
}

#[test]
fn a_recorded_path_is_rendered_as_it_was_seen() {
    let space = fields();
    let viewer = Viewer::new(&space, &["out/fields/fit/field"]);
    assert_eq!(viewer.said["fields"], json!(["fit"]));
    let pose = json!([[0.8, 0, 0.6, 0.3], [0, 1, 0, 0.5], [-0.6, 0, 0.8, 1.5]]);
    let turned = json!({"free": {"like": 0, "pose": pose}});
    let stands = [json!({"photo": 2}), turned.clone()];
    let path = viewer.ask("POST", "path", &json!({"stands": stands}).to_string());
    assert_eq!(path.status, 200);
    fs::write(space.path("transforms.json"), &path.body).unwrap();
    let flight = FIELDS.replace(
        "field: \"sync\"",
        "field: \"fit\", path: Some(File(path: \"transforms.json\"))",
    );
    fs::write(
        space.path("flight.ron"),
        flight.replace("\"fields\"", "\"flight\""),
    )
    .unwrap();
    space.ok(&["run", "flight.ron", "--device", "cpu"]);
    for (frame, stand) in stands.into_iter().enumerate() {
        let mut look = look(0, 32);
        look["stand"] = stand;
        let seen = whole(&viewer.frames(&look));
        assert_eq!(
            seen,
            shown(&space, "out/flight/render/images", frame),
            "frame {frame}"
        );
    }
}
