//! Rays, projections and windows of cameras of any kind.

use super::*;
use glam::DQuat;
use proptest::prelude::*;

const NONE: Distortion = Distortion {
    k1: 0.0,
    k2: 0.0,
    k3: 0.0,
    p1: 0.0,
    p2: 0.0,
    k4: 0.0,
    k5: 0.0,
    k6: 0.0,
    fisheye: false,
};

/// None, or one as phones have it.
fn any_lens() -> impl Strategy<Value = Distortion> {
    let bent = (
        -0.06..0.06f64,
        -0.02..0.02f64,
        -0.005..0.005f64,
        -0.005..0.005f64,
    );
    prop_oneof![
        Just(NONE),
        bent.prop_map(|(k1, k2, p1, p2)| Distortion {
            k1,
            k2,
            p1,
            p2,
            ..NONE
        })
    ]
}

fn any_camera() -> impl Strategy<Value = Camera> {
    let pose = (
        prop::array::uniform3(-9.0..9.0f64),
        prop::array::uniform3(-3.0..3.0f64),
    );
    (
        pose,
        40..900u32,
        40..900u32,
        50.0..2000.0f64,
        50.0..2000.0f64,
        0.2..0.8f64,
        any_lens(),
    )
        .prop_map(
            |((position, turn), width, height, fl_x, fl_y, middle, distortion)| Camera {
                distortion: if f64::from(width).max(height.into()) < 1.5 * fl_x.min(fl_y) {
                    distortion
                } else {
                    NONE
                },
                width,
                height,
                fl_x,
                fl_y,
                cx: f64::from(width) * middle,
                cy: f64::from(height) * (1.0 - middle),
                camera_to_world: DMat4::from_rotation_translation(
                    DQuat::from_scaled_axis(turn.into()),
                    position.into(),
                ),
                near: 1.0,
                far: 5.0,
            },
        )
}

fn along(ray: &Ray, depth: f64) -> [f64; 3] {
    let distance = depth * f64::from(ray.distance_per_depth);
    std::array::from_fn(|i| f64::from(ray.origin[i]) + distance * f64::from(ray.direction[i]))
}

proptest! {
    #[test]
    fn project_inverts_ray(camera in any_camera(), u in 0.0..1.0f64, v in 0.0..1.0f64, depth in 0.1..50.0f64) {
        let px = u * f64::from(camera.width);
        let py = v * f64::from(camera.height);
        let ray = camera.ray(px, py);
        let seen = camera.project(along(&ray, depth)).unwrap();
        // Rays are f32: their rounding, about 1e-6 of the distance, shows as so many focal lengths
        // of pixels.
        let tolerance = 1e-5 * f64::from(ray.distance_per_depth) * (1.0 + 10.0 / depth);
        prop_assert!((seen[0] - px).abs() < tolerance * camera.fl_x, "{seen:?} for {px} {py}");
        prop_assert!((seen[1] - py).abs() < tolerance * camera.fl_y, "{seen:?} for {px} {py}");
        prop_assert!((seen[2] - depth).abs() < tolerance * depth);
    }

    #[test]
    fn project_inverts_unproject(camera in any_camera(), u in 0.0..1.0f64, v in 0.0..1.0f64, depth in 0.1..50.0f64) {
        let px = u * f64::from(camera.width);
        let py = v * f64::from(camera.height);
        let seen = camera.project(camera.unproject(px, py, depth)).unwrap();
        for (got, want) in seen.into_iter().zip([px, py, depth]) {
            prop_assert!((got - want).abs() < 1e-8 * (1.0 + want.abs()), "{seen:?}");
        }
    }

    #[test]
    fn scaling_keeps_the_image_plane(camera in any_camera(), w in 1..400u32, h in 1..400u32, u in 0.0..1.0f64, v in 0.0..1.0f64) {
        let scaled = camera.scaled(w, h);
        let a = camera.unproject(u * f64::from(camera.width), v * f64::from(camera.height), 2.0);
        let b = scaled.unproject(u * f64::from(w), v * f64::from(h), 2.0);
        for i in 0..3 {
            prop_assert!((a[i] - b[i]).abs() < 1e-9 * (1.0 + a[i].abs()), "{a:?} {b:?}");
        }
    }
}

fn front_camera() -> Camera {
    Camera {
        width: 8,
        height: 6,
        fl_x: 4.0,
        fl_y: 4.0,
        cx: 4.0,
        cy: 3.0,
        distortion: NONE,
        camera_to_world: DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)),
        near: 1.0,
        far: 4.0,
    }
}

#[test]
fn an_unturned_camera_looks_along_minus_z_with_y_up() {
    let camera = front_camera();
    assert_eq!(camera.ray(4.0, 3.0).direction, [0.0, 0.0, -1.0]);
    assert_eq!(camera.ray(4.0, 3.0).distance_per_depth, 1.0);
    let top_left = camera.ray(0.5, 0.5).direction;
    assert!(top_left[0] < 0.0 && top_left[1] > 0.0, "{top_left:?}");
    assert_eq!(camera.unproject(0.0, 0.0, 4.0), [-3.0, 5.0, -1.0]);
    assert_eq!(camera.project([1.0, 2.0, 3.5]), None, "behind the camera");
}

#[test]
fn look_at_puts_the_target_in_the_middle_and_up_upwards() {
    let position = DVec3::new(2.0, 1.5, 3.0);
    let target = DVec3::new(0.0, 0.5, -0.2);
    let camera = Camera {
        camera_to_world: Camera::look_at(position, target),
        ..front_camera()
    };
    let seen = camera.project(target.to_array()).unwrap();
    assert!(
        (seen[0] - 4.0).abs() < 1e-9 && (seen[1] - 3.0).abs() < 1e-9,
        "{seen:?}"
    );
    assert!((seen[2] - position.distance(target)).abs() < 1e-9);
    assert!(
        camera.project((target + DVec3::Y).to_array()).unwrap()[1] < 3.0,
        "up is towards row 0"
    );
}

#[test]
fn a_bent_lens_widens_the_window_to_all_that_is_seen() {
    let barrel = |k1| Camera {
        distortion: Distortion { k1, ..NONE },
        ..front_camera()
    };
    let straight = front_camera().view_window();
    let bent = barrel(-0.05).view_window();
    assert_eq!(straight, [-1.0, 1.0, -0.75, 0.75]);
    assert!(bent[0] < straight[0] && bent[3] > straight[3], "{bent:?}");
    assert!(barrel(-0.05).sees_through_its_image());
    assert!(
        !barrel(-0.2).sees_through_its_image(),
        "its corners, 1.25 focal lengths off, lie past the fold"
    );
    let pincushion = Camera {
        distortion: Distortion { k1: 0.2, ..NONE },
        ..front_camera()
    };
    assert!(pincushion.sees_through_its_image());
    let window = pincushion.view_window();
    for i in 0..=100 {
        let p = pincushion.at_unit_depth(8.0 * f64::from(i) / 100.0, 0.0);
        assert!(
            p.x > window[0] - 1e-3 && p.x < window[1] + 1e-3 && p.y < window[3] + 1e-3,
            "{p}"
        );
    }
    assert_eq!(
        barrel(-0.05).project([1.0 + 40.0, 2.0, 2.0]),
        None,
        "no ray goes so far aside"
    );
}

#[test]
fn frustum_corners_lie_on_the_near_and_far_planes() {
    let camera = front_camera();
    let depths: Vec<f64> = camera
        .frustum_corners()
        .map(|p| camera.project(p).unwrap()[2])
        .to_vec();
    assert_eq!(depths, [1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0]);
}

#[test]
fn files_hold_rows_and_a_camera_stands_where_its_last_column_says() {
    let rows = r#"[[0.0,-1.0,0.0,5.0],[1.0,0.0,0.0,6.0],[0.0,0.0,1.0,7.0],[0.0,0.0,0.0,1.0]]"#;
    let lens = r#""width":2,"height":3,"fl_x":2.0,"fl_y":2.5,"cx":1.0,"cy":1.5"#;
    let bent = r#""distortion":{"k1":0.1,"k2":0.0,"k3":0.0,"p1":0.0,"p2":0.0,"fisheye":true}"#;
    let text = format!(r#"{{{lens},{bent},"camera_to_world":{rows},"near":1.0,"far":9.0}}"#);
    let camera: Camera = serde_json::from_str(&text).unwrap();
    assert_eq!(camera.position().to_array(), [5.0, 6.0, 7.0]);
    assert_eq!(serde_json::to_string(&camera).unwrap(), text);
}

#[test]
fn what_no_file_may_say_is_refused() {
    let camera = Camera::centered((5, 4), 6.0, DMat4::IDENTITY, [0.1, 9.0]);
    assert_eq!(camera.check(), Ok(()));
    let said = |camera: Camera| camera.check().unwrap_err().to_string();
    let wide = Camera {
        width: 65_537,
        ..camera
    };
    assert_eq!(
        said(wide),
        "is 65537x4; expected 1 to 65536 pixels each way"
    );
    let bent = Camera {
        distortion: Distortion {
            k6: f64::INFINITY,
            ..NONE
        },
        ..camera
    };
    assert_eq!(said(bent), "its camera holds inf; all must be finite");
    let flat = Camera {
        camera_to_world: DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0)),
        ..camera
    };
    assert_eq!(said(flat), "its camera-to-world matrix cannot be inverted");
}
