//! Cameras as glTF 2.0: a node each, or one whose place and turn are animated. Fields of view are of
//! pinholes that look through the picture's middle.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use super::{Shot, Up, glb};
use crate::Camera;

/// glTF's number for 32-bit floats.
const FLOAT: u32 = 5126;
/// A quarter turn about x, which takes +z to +y, glTF's upwards.
const Z_TO_Y: [f64; 4] = [
    -std::f64::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f64::consts::FRAC_1_SQRT_2,
];
/// The node that is animated: the first below the root.
const MOVING: usize = 1;

/// JSON with its numbers within it.
pub fn text(shot: &Shot) -> String {
    let (mut page, numbers) = page(shot);
    if !numbers.is_empty() {
        // As a data URI, so that all is one file.
        let data = STANDARD.encode(&numbers);
        page["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{data}"));
    }
    format!("{page:#}\n")
}

/// One binary file: the JSON, and its numbers behind it.
pub fn binary(shot: &Shot) -> Vec<u8> {
    let (page, numbers) = page(shot);
    let mut bytes = Vec::new();
    // A vector takes all bytes, and cameras never fill the 4 GiB that the format has room for.
    let _ = glb::head(page.to_string(), numbers.len(), &mut bytes);
    bytes.extend(numbers);
    bytes
}

fn page(shot: &Shot) -> (Value, Vec<u8>) {
    let shown = match shot.moves {
        true => &shot.cameras[..1],
        false => &shot.cameras[..],
    };
    let mut root = json!({"name": "cameras", "children": (1..=shown.len()).collect::<Vec<_>>()});
    // One turn of the root, so that all places below stay the scene's own numbers.
    if shot.up == Up::Z {
        root["rotation"] = json!(Z_TO_Y);
    }
    let mut nodes = vec![root];
    let mut cameras = Vec::new();
    for (i, (name, camera)) in shown.iter().enumerate() {
        let name = if shot.moves { "camera" } else { name };
        nodes.push(json!({
            "name": name,
            "camera": i,
            "translation": camera.position().to_array(),
            "rotation": turn(camera).to_array(),
        }));
        cameras.push(json!({"name": name, "type": "perspective", "perspective": lens(camera)}));
    }
    let mut page = json!({
        "asset": {"version": "2.0", "generator": "srnerf-dag"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "cameras": cameras,
    });
    if !shot.moves {
        return (page, Vec::new());
    }
    let numbers = animate(shot, &mut page);
    (page, numbers)
}

fn lens(camera: &Camera) -> Value {
    // Of the image plane at distance 1; glTF's axis goes through its middle.
    let window = [
        f64::from(camera.width) / camera.fl_x,
        f64::from(camera.height) / camera.fl_y,
    ];
    json!({
        "yfov": 2.0 * (window[1] / 2.0).atan(),
        "aspectRatio": window[0] / window[1],
        "znear": camera.near,
        "zfar": camera.far,
    })
}

/// Adds the animation, and gives its numbers: times, places, turns.
fn animate(shot: &Shot, page: &mut Value) -> Vec<u8> {
    let frames = shot.cameras.len();
    // Each from its number: a frame's time, added up, would drift.
    let times: Vec<f32> = (0..frames).map(|i| shot.rate.time(i) as f32).collect();
    let places = shot.cameras.iter().map(|(_, camera)| camera.position());
    let places: Vec<f32> = places
        .flat_map(|place: DVec3| place.as_vec3().to_array())
        .collect();
    let turns: Vec<f32> = turns(shot)
        .iter()
        .flat_map(|turn| turn.as_quat().to_array())
        .collect();
    let mut accessors = Vec::new();
    let mut views = Vec::new();
    let mut bytes = Vec::new();
    for (i, (kind, column)) in [("SCALAR", &times), ("VEC3", &places), ("VEC4", &turns)]
        .into_iter()
        .enumerate()
    {
        let start = bytes.len();
        bytes.extend(column.iter().flat_map(|number| number.to_le_bytes()));
        views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len() - start}));
        accessors
            .push(json!({"bufferView": i, "componentType": FLOAT, "count": frames, "type": kind}));
    }
    // The format demands the bounds of an animation's times.
    accessors[0]["min"] = json!([times.first()]);
    accessors[0]["max"] = json!([times.last()]);
    let channel = |sampler: usize, path: &str| json!({"sampler": sampler, "target": {"node": MOVING, "path": path}});
    page["animations"] = json!([{
        "name": "path",
        "channels": [channel(0, "translation"), channel(1, "rotation")],
        "samplers": [{"input": 0, "output": 1, "interpolation": "LINEAR"}, {"input": 0, "output": 2, "interpolation": "LINEAR"}],
    }]);
    page["accessors"] = json!(accessors);
    page["bufferViews"] = json!(views);
    page["buffers"] = json!([{"byteLength": bytes.len()}]);
    bytes
}

fn turn(camera: &Camera) -> DQuat {
    DQuat::from_mat3(&DMat3::from_mat4(camera.camera_to_world)).normalize()
}

/// The turns of all frames. A turn and its negative are the same; the one nearer to the frame before
/// is taken, so that programs that do not look go the short way.
fn turns(shot: &Shot) -> Vec<DQuat> {
    let mut before: Option<DQuat> = None;
    let near = |(_, camera): &(String, Camera)| {
        let now = turn(camera);
        let now = match before {
            // Both signs are one turn; a viewer that goes from one to the other turns the long way.
            Some(before) if before.dot(now) < 0.0 => -now,
            _ => now,
        };
        before = Some(now);
        now
    };
    shot.cameras.iter().map(near).collect()
}
