//! Lenses, boxes and places of cameras.

use super::{capture, for_frames, holds, read, refusal, ring, transforms};
use glam::DVec3;
use serde_json::json;

#[test]
fn a_lens_that_folds_the_image_is_told_in_numbers_with_a_remedy() {
    let folder = capture(|page| {
        page["k1"] = json!(-44.0);
        page["p1"] = json!(0.6);
    });
    let said = refusal(&folder);
    holds(
        &said,
        &[
            "frame \"images/0000.png\"",
            "k1 = -44, p1 = 0.6",
            "undistort",
        ],
    );
    assert!(!said.contains('{'), "no debug print: {said}");
}

#[test]
fn camera_models_are_read_in_any_case_and_with_fields_of_view() {
    let folder = capture(|page| {
        page["camera_model"] = json!("opencv_fisheye");
        page["k1"] = json!(0.01);
        page.as_object_mut().unwrap().remove("fl_x");
        page["x_fov"] = json!(60.0);
    });
    let scene = transforms(&folder).unwrap();
    let camera = &scene.photos[0].camera;
    assert!(camera.distortion.fisheye && camera.distortion.k1 == 0.01);
    assert!((camera.fl_x - 8.0 / 30f64.to_radians().tan()).abs() < 1e-12);
    assert_eq!(scene.notes, Vec::<String>::new());
}

#[test]
fn a_wide_fisheye_is_masked_beyond_its_rim() {
    let folder = capture(|page| {
        page["is_fisheye"] = json!(true);
        page["fl_x"] = json!(6.0);
    });
    let scene = transforms(&folder).unwrap();
    let mask = scene.photos[0].mask.as_ref().unwrap();
    assert!(!mask[0], "its corner is 95 degrees off");
    assert!(mask[6 * 16 + 8], "its middle is not");
    holds(&scene.notes.join("\n"), &["9 of 9 photos are masked"]);
}

#[test]
fn a_box_that_no_camera_sees_is_refused_with_what_to_set() {
    let folder = capture(|page| {
        for_frames(page, |_, frame| {
            // Far below the box, and looking down.
            let height = &mut frame["transform_matrix"][1][3];
            *height = json!(height.as_f64().unwrap() - 40.0);
        });
    });
    holds(
        &refusal(&folder),
        &[
            "the scene box",
            "is seen by no camera",
            "-40.00",
            "`bounds`",
        ],
    );
}

#[test]
fn cameras_at_one_place_are_refused() {
    let folder = capture(|page| {
        for_frames(page, |_, frame| {
            (0..3).for_each(|row| frame["transform_matrix"][row][3] = json!(0.25));
        });
    });
    holds(&refusal(&folder), &["all 9 cameras: stand at one place"]);
}

#[test]
fn a_principal_point_outside_the_photo_is_noted_and_one_far_outside_refused() {
    let folder = capture(|page| page["cx"] = json!(20.0));
    holds(
        &read(&folder).1,
        &["the principal point (20, 6)", "outside its 16x12 pixels"],
    );
    let folder = capture(|page| page["cx"] = json!(400.0));
    holds(&refusal(&folder), &["(400, 6) lies far outside"]);
}

#[test]
fn georeferenced_cameras_keep_their_digits_and_the_way_back() {
    let offset = [448_262.0, 5_411_932.0, 480.0];
    let folder = capture(|page| {
        page.as_object_mut().unwrap().remove("aabb_scale");
        for_frames(page, |_, frame| {
            for (row, offset) in offset.iter().enumerate() {
                let value = frame["transform_matrix"][row][3].as_f64().unwrap();
                frame["transform_matrix"][row][3] = json!(value + offset);
            }
        });
    });
    let scene = transforms(&folder).unwrap();
    holds(
        &scene.notes.join("\n"),
        &["far from the origin", "goes back"],
    );
    for (photo, known) in scene.photos.iter().zip(ring(9)) {
        let position = photo.camera.position();
        assert!(position.length() < 3.0, "{position}");
        let back = scene.to_source.transform_point3(position);
        assert!(
            back.distance(known.position() + DVec3::from(offset)) < 1e-6,
            "{back}"
        );
    }
}
