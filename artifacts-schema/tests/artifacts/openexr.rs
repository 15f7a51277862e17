//! The camera in an EXR's standard attributes says the same as `transforms.json`.

use artifacts_schema::Artifact;
use exr::meta::MetaData;
use exr::meta::attribute::Text;
use formats::{Camera, rows};
use tempfile::tempdir;

use crate::samples;

/// A row vector times one of OpenEXR's matrices, divided by w.
fn transform(point: [f64; 3], matrix: [f32; 16]) -> [f64; 3] {
    let [x, y, z] = point;
    let column = |index: usize| -> f64 {
        let weights = [x, y, z, 1.0];
        (0..4)
            .map(|row| weights[row] * f64::from(matrix[4 * row + index]))
            .sum()
    };
    [0, 1, 2].map(|index| column(index) / column(3))
}

/// A point given in OpenGL camera space (looking along -z), in the world.
fn in_world(camera: &Camera, point: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = point;
    [0, 1, 2].map(|row| {
        let [a, b, c, d] = rows::of(&camera.camera_to_world)[row];
        a * x + b * y + c * z + d
    })
}

fn close(left: [f64; 3], right: [f64; 3]) -> bool {
    left.iter()
        .zip(right)
        .all(|(left, right)| (left - right).abs() < 1e-5)
}

#[test]
fn matrices_are_left_handed_row_vector_and_upper_left() {
    let folder = tempdir().unwrap();
    samples::images()
        .write(folder.path(), &samples::provenance())
        .unwrap();
    let meta = MetaData::read_from_file(folder.path().join("view_000.exr"), true).unwrap();
    let attributes = &meta.headers[0].own_attributes;
    let camera = samples::camera();
    let world_to_camera = attributes.world_to_camera.unwrap();
    let world_to_ndc = attributes.world_to_normalized_device.unwrap();

    let right_up_ahead = in_world(&camera, [0.5, 0.25, -2.0]);
    assert!(close(
        transform(right_up_ahead, world_to_camera),
        [0.5, 0.25, 2.0]
    ));

    // By hand: x = cx + fl_x 0.5 / 2, y = cy - fl_y 0.25 / 2, as fractions of width and height;
    // then 1 / depth.
    let x = (2.4 + 6.1 * 0.25) / 5.0;
    let y = (2.1 - 0.125 / 0.17) / 4.0;
    assert!(close(transform(right_up_ahead, world_to_ndc), [x, y, 0.5]));

    // The screen window spans the image at distance 1, y up.
    let width = f64::from(attributes.screen_window_width);
    assert!((width - 5.0 / 6.1).abs() < 1e-6);
    let left = f64::from(attributes.screen_window_center.0) - width / 2.0;
    assert!((transform(in_world(&camera, [left, 0.0, -1.0]), world_to_ndc)[0]).abs() < 1e-5);
    let middle = f64::from(attributes.screen_window_center.1);
    assert!(
        (transform(in_world(&camera, [0.0, middle, -1.0]), world_to_ndc)[1] - 0.5).abs() < 1e-5
    );
}

#[test]
fn a_bent_lens_stands_beside_the_provenance() {
    let folder = tempdir().unwrap();
    let mut images = samples::images();
    images.views[0].camera.distortion.k1 = 0.25;
    images.write(folder.path(), &samples::provenance()).unwrap();
    let about = |view: &str| -> serde_json::Value {
        let meta = MetaData::read_from_file(folder.path().join(view), true).unwrap();
        let text = meta.headers[0].own_attributes.other[&Text::from("srnerf")]
            .to_text()
            .unwrap()
            .to_string();
        serde_json::from_str(&text).unwrap()
    };
    assert_eq!(about("view_000.exr")["distortion"]["k1"], 0.25);
    assert_eq!(about("view_000.exr")["kind"], "Render");
    assert!(about("view_001.exr").get("distortion").is_none());
}
