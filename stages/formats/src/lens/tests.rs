//! Lenses there and back, and what is none.

use super::*;

#[test]
fn a_camera_comes_back_from_what_a_file_says() {
    let pose = DMat4::from_translation([1.0, 2.0, 3.0].into());
    for distortion in [
        Distortion::default(),
        Distortion::fisheye([0.1, 0.01, 0.0, 0.2]),
        Distortion {
            k1: 0.1,
            k6: 0.02,
            ..Distortion::default()
        },
    ] {
        let camera = Camera {
            distortion,
            ..Camera::centered((3, 2), 4.5, pose, [0.5, 7.0])
        };
        let text = serde_json::to_string(&Lens::of(&camera)).unwrap();
        let lens: Lens = serde_json::from_str(&text).unwrap();
        assert_eq!(lens.camera(pose), Ok(camera), "{text}");
    }
}

#[test]
fn a_field_that_is_not_said_is_named() {
    let frame = Lens {
        fl_x: Some(2.0),
        ..Lens::default()
    };
    let shared = Lens {
        w: Some(3),
        h: Some(2),
        fl_x: Some(1.0),
        ..Lens::default()
    };
    let lens = frame.or(&shared);
    assert_eq!(lens.fl_x, Some(2.0));
    let missing = lens.camera(DMat4::IDENTITY).unwrap_err();
    let text = "has no fl_y, nor is there one for all frames";
    assert_eq!(missing.to_string(), text);
}

#[test]
fn other_values_than_numbers_are_refused() {
    let read = |text: &str| serde_json::from_str::<Lens>(text);
    assert_eq!(read(r#"{"w": 540.0, "k1": null}"#).unwrap().w, Some(540));
    for (text, problem) in [
        (r#"{"fl_x": "a"}"#, "is \"a\"; expected a number"),
        (r#"{"w": 1.5}"#, "is not a whole number of pixels"),
        (r#"{"is_fisheye": 1}"#, "is 1; expected true or false"),
    ] {
        let said = read(text).unwrap_err().to_string();
        assert!(said.starts_with(problem), "{said}");
    }
}

#[test]
fn the_model_covers_all_lenses() {
    let plain = Distortion::default();
    let fisheye = Distortion::fisheye([0.1, 0.0, 0.0, 0.1]);
    let full = Distortion { k5: 0.1, ..plain };
    let of = |lenses: &[Distortion]| model(lenses.iter());
    assert_eq!(of(&[]), "OPENCV");
    assert_eq!(of(&[plain, fisheye]), "OPENCV");
    assert_eq!(of(&[fisheye, fisheye]), "OPENCV_FISHEYE");
    assert_eq!(of(&[plain, full, fisheye]), "FULL_OPENCV");
}
