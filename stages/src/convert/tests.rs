//! Conversions there and back.

use artifacts_schema::{Artifact, ImageSet, Provenance, View};
use compute::Device;
use formats::{Camera, Distortion, Pixels};
use glam::DMat4;
use scene::Reader;

use super::*;

fn view() -> View {
    let camera = Camera::centered((2, 3), 2.0, DMat4::IDENTITY, [1.0, 9.0]);
    let rgb = (0..18).map(|i| i as f32 / 17.0).collect();
    View {
        name: "view_000".into(),
        camera,
        pixels: Pixels::opaque(rgb),
        depth: None,
        mask: None,
    }
}

#[test]
fn colours_come_back_from_planes_and_from_srgb() {
    let view = view();
    let device = Device::cpu();
    assert_eq!(srgb_array(&view, &device).shape(), [1, 3, 3, 2]);
    assert_eq!(pixels(&linear_array(&view, &device)), view.pixels.rgb);
    let alpha = vec![1.0, 0.5, 0.25, 1.0, 0.9, 1.0];
    // Colours are multiplied by alpha: none is brighter.
    let numbers = view.pixels.rgb.iter().enumerate();
    let rgb = numbers.map(|(i, x)| x * alpha[i / 3]).collect();
    let transparent = View {
        pixels: Pixels::new(rgb, Some(alpha)),
        ..view.clone()
    };
    for view in [view, transparent] {
        let alpha = &view.pixels.alpha;
        let signed = signed_array(&view, &device);
        for back in [
            disk_pixels(&srgb_array(&view, &device), alpha.clone()),
            disk_pixels_of_signed(&signed, alpha.clone()),
        ] {
            assert!(
                back.rgb
                    .iter()
                    .zip(&view.pixels.rgb)
                    .all(|(a, b)| (a - b).abs() < 1e-6),
                "{back:?}"
            );
        }
    }
}

/// An image set with lenses that bend is read back by ourselves, and by our reader of scenes.
#[test]
fn an_image_set_of_any_lens_is_a_scene() {
    let bent = |distortion| View {
        camera: Camera {
            distortion,
            ..view().camera
        },
        ..view()
    };
    let full = bent(Distortion {
        k1: 0.02,
        k4: 0.01,
        k5: -0.002,
        k6: 0.001,
        ..Distortion::default()
    });
    let fisheye = bent(Distortion::fisheye([0.01, 0.0, 0.0, 0.002]));
    for lenses in [
        vec![full.clone(), full.clone()],
        vec![fisheye.clone(), fisheye.clone()],
        vec![view(), full, fisheye],
    ] {
        let placed = |(i, view): (usize, View)| View {
            name: format!("view_{i:03}"),
            camera: Camera {
                camera_to_world: DMat4::from_translation([i as f64, 0.0, 0.0].into()),
                ..view.camera
            },
            ..view
        };
        let images = ImageSet {
            views: lenses.into_iter().enumerate().map(placed).collect(),
            bounds: [[-2.0; 3], [2.0; 3]],
            to_source: None,
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        images.write(path, &Provenance::default()).unwrap();
        assert_eq!(ImageSet::read(path).unwrap(), images);
        let reader = scene::Transforms {
            path: path.to_owned(),
            ..scene::Transforms::default()
        };
        let cameras = reader.read().unwrap().photos;
        let cameras: Vec<Camera> = cameras.iter().map(|photo| photo.camera).collect();
        let written: Vec<Camera> = images.views.iter().map(|view| view.camera).collect();
        assert_eq!(cameras, written);
    }
}

#[test]
fn a_range_names_the_bound_that_was_crossed() {
    assert!(in_range("steps", 1, 1, 9).is_ok());
    let problem = |value| in_range("steps", value, 1, 9).unwrap_err().to_string();
    assert_eq!(problem(0), "`steps` is 0; it must be at least 1");
    assert_eq!(problem(10), "`steps` is 10; it must be at most 9");
}
