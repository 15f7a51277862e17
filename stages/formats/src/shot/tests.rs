use glam::{DMat4, DVec3};
use serde_json::Value;

use super::*;

/// A camera beside the origin, with a lens of its own.
fn camera(i: u32) -> Camera {
    let angle = 0.3 * f64::from(i);
    let place = DVec3::new(4.0 * angle.cos(), 0.5, 4.0 * angle.sin());
    let pose = Camera::look_at(place, DVec3::ZERO);
    Camera {
        fl_y: 51.0,
        cx: 33.5,
        ..Camera::centered((64, 48), 50.0, pose, [0.5, 9.0])
    }
}

fn shot(moves: bool) -> Shot {
    Shot {
        cameras: (0..5).map(|i| (format!("view-{i}"), camera(i))).collect(),
        moves,
        rate: Rate::whole(24),
        first: 1001,
        up: Up::Z,
    }
}

/// The numbers behind `what` in a line of USD's text.
fn numbers(line: &str) -> Vec<f64> {
    let value = line.split_once(['=', ':']).unwrap().1;
    let value = value.split_once('=').map_or(value, |(_, value)| value);
    let words = value
        .split(['(', ')', ',', ' '])
        .filter(|word| !word.is_empty());
    words.map(|word| word.parse().unwrap()).collect()
}

#[test]
fn usd_holds_poses_to_the_last_bit_and_lenses_to_single_precision() {
    let text = String::from_utf8(shot(false).to_bytes(Format::Usda)).unwrap();
    let line = |what: &str, i: usize| {
        let mut lines = text
            .lines()
            .filter(|line| line.trim_start().starts_with(what));
        numbers(lines.nth(i).unwrap())
    };
    for i in 0..5 {
        let truth = camera(i as u32);
        let pose: [f64; 16] = line("matrix4d", i).try_into().unwrap();
        assert_eq!(DMat4::from_cols_array(&pose), truth.camera_to_world);
        let focal = line("float focalLength", i)[0];
        let width = line("float horizontalAperture ", i)[0];
        let height = line("float verticalAperture ", i)[0];
        let right = line("float horizontalApertureOffset", i)[0];
        assert!((focal / width * 64.0 - truth.fl_x).abs() < 1e-5);
        assert!((focal / height * 48.0 - truth.fl_y).abs() < 1e-5);
        assert!((32.0 - right / focal * truth.fl_x - truth.cx).abs() < 1e-5);
    }
    assert!(text.contains("def Camera \"view_0\" (\n        displayName = \"view-0\"\n"));
}

#[test]
fn usd_has_a_sample_for_each_frame_of_what_moves() {
    let text = String::from_utf8(shot(true).to_bytes(Format::Usda)).unwrap();
    for part in [
        "    endTimeCode = 1005\n    framesPerSecond = 24\n    startTimeCode = 1001\n",
        "        float focalLength = 28.125\n",
        "        matrix4d xformOp:transform.timeSamples = {\n            1001: ( (",
        "            1005: ( (",
    ] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
}

#[test]
fn gltf_holds_still_cameras_to_double_precision() {
    let page: Value = serde_json::from_slice(&shot(false).to_bytes(Format::Gltf)).unwrap();
    for i in 0..5u32 {
        let truth = camera(i);
        let node = &page["nodes"][i as usize + 1];
        let list = |what: &str| -> Vec<f64> { serde_json::from_value(node[what].clone()).unwrap() };
        let turn: [f64; 4] = list("rotation").try_into().unwrap();
        let place: [f64; 3] = list("translation").try_into().unwrap();
        let pose = DMat4::from_rotation_translation(glam::DQuat::from_array(turn), place.into());
        assert!(pose.abs_diff_eq(truth.camera_to_world, 1e-14));
        let lens = &page["cameras"][i as usize]["perspective"];
        let tan = (lens["yfov"].as_f64().unwrap() / 2.0).tan();
        assert!((24.0 / tan - truth.fl_y).abs() < 1e-12);
        let aspect = lens["aspectRatio"].as_f64().unwrap();
        assert!((32.0 / (tan * aspect) - truth.fl_x).abs() < 1e-12);
    }
}

#[test]
fn both_files_of_gltf_have_the_same_numbers() {
    use base64::Engine as _;
    let page: Value = serde_json::from_slice(&shot(true).to_bytes(Format::Gltf)).unwrap();
    let uri = page["buffers"][0]["uri"].as_str().unwrap();
    let data = uri.split_once(',').unwrap().1;
    let data = base64::engine::general_purpose::STANDARD
        .decode(data)
        .unwrap();
    let binary = shot(true).to_bytes(Format::Glb);
    assert!(binary.ends_with(&data));
    assert_eq!(data.len(), 5 * 4 * (1 + 3 + 4));
    assert_eq!(binary[8..12], (binary.len() as u32).to_le_bytes());
    let place = camera(4).position().as_vec3();
    let at = 5 * 4 + 4 * 12;
    assert_eq!(data[at..at + 4], place.x.to_le_bytes());
    assert_eq!(
        page["accessors"][0]["max"][0].as_f64(),
        Some(f64::from(4.0f32 / 24.0))
    );
}

#[test]
fn what_is_left_out_is_told() {
    assert_eq!(shot(true).left_out(Format::Usda), Vec::<String>::new());
    let notes = shot(true).left_out(Format::Glb);
    assert!(notes[0].contains("up to 1.50 pixels"), "{notes:?}");
    let mut zoom = shot(true);
    zoom.cameras[1].1.fl_x = 60.0;
    zoom.cameras[1].1.distortion.k1 = 0.1;
    assert_eq!(zoom.left_out(Format::Gltf).len(), 3);
    let text = String::from_utf8(zoom.to_bytes(Format::Usda)).unwrap();
    assert!(text.contains("float focalLength.timeSamples = {\n            1001: 28.125,\n"));
}
