//! The embedded object: the same bits however it is made, on nothing, seen from all around.
#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

use scene::{Photo, Reader, Reducer, SceneData, Transforms, downscale, object, write_transforms};

fn with_threads(threads: usize, make: impl Fn() -> SceneData + Send + Sync) -> SceneData {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(make)
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let make = || object(2, (24, 24), 2, 7);
    assert_eq!(with_threads(1, make), with_threads(3, make));
}

/// Share of the image that shows something.
fn covered(photo: &Photo) -> f32 {
    let alpha = photo.pixels.alpha.as_ref().unwrap();
    alpha.iter().sum::<f32>() / alpha.len() as f32
}

#[test]
fn every_photo_shows_it_whole_on_nothing() {
    let scene = object(12, (48, 48), 2, 0);
    assert_eq!((scene.photos.len(), scene.test.len()), (12, 3));
    for photo in scene.photos.iter().chain(&scene.test) {
        assert!(
            (0.12..0.6).contains(&covered(photo)),
            "{}: {}",
            photo.name,
            covered(photo)
        );
        let alpha = photo.pixels.alpha.as_ref().unwrap();
        let rim = (0..48).flat_map(|i| [i, 47 * 48 + i, 48 * i, 48 * i + 47]);
        assert!(
            rim.into_iter().all(|i| alpha[i] == 0.0),
            "{} is cut off",
            photo.name
        );
        let position = photo.camera.position();
        assert!(
            (position.length() - 4.031).abs() < 1e-3 && position.z > -1e-9,
            "the cameras stand above, z up"
        );
        assert!(
            photo.camera.near > 2.0 && photo.camera.far < 6.0,
            "NeRF-synthetic's near and far"
        );
    }
    assert!(
        scene
            .bounds
            .as_flattened()
            .iter()
            .all(|side| side.abs() < 1.3),
        "{:?}",
        scene.bounds
    );
}

#[test]
fn the_seed_moves_the_training_cameras() {
    let a = object(4, (8, 8), 1, 0);
    let b = object(4, (8, 8), 1, 1);
    let apart = |i: usize, j: usize| {
        a.photos[i]
            .camera
            .position()
            .distance(b.photos[j].camera.position())
    };
    assert!(apart(0, 0) > 0.05 && apart(1, 1) > 0.05);
    assert_eq!(
        a.test[0].camera.camera_to_world,
        b.test[0].camera.camera_to_world
    );
}

/// Before any background, the reduced photo is the reduction of the photo before it.
#[test]
fn reducing_and_putting_before_a_background_may_change_places() {
    let scene = object(1, (48, 48), 2, 0);
    let photo = &scene.photos[0];
    for white in [0.0, 1.0] {
        let before = |photo: &Photo| {
            assert!(photo.pixels.alpha.is_some());
            Photo {
                pixels: photo.pixels.clone().before(white),
                ..photo.clone()
            }
        };
        let one = before(&downscale(photo, 4, Reducer::Area).unwrap())
            .pixels
            .rgb;
        let other = downscale(&before(photo), 4, Reducer::Area)
            .unwrap()
            .pixels
            .rgb;
        let most = one
            .iter()
            .zip(&other)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(most < 1e-5, "{most} before {white}");
    }
}

#[test]
fn written_as_nerf_synthetic_it_reads_back_to_the_nearest_eighth_bit() {
    let scene = object(3, (24, 24), 2, 0);
    let folder = tempfile::tempdir().unwrap();
    write_transforms(folder.path(), &scene.photos, &scene.test, scene.bounds).unwrap();
    let source = Transforms {
        path: folder.path().to_owned(),
        ..Transforms::default()
    };
    let read = source.read().unwrap();
    assert_eq!(
        (read.bounds, read.photos.len(), read.test.len()),
        (scene.bounds, 3, 1)
    );
    for (was, is) in scene
        .photos
        .iter()
        .chain(&scene.test)
        .zip(read.photos.iter().chain(&read.test))
    {
        assert_eq!((&was.name, &was.camera), (&is.name, &is.camera));
        let near =
            |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.501 / 255.0);
        assert!(
            near(&was.pixels.rgb, &is.pixels.rgb)
                && near(
                    was.pixels.alpha.as_ref().unwrap(),
                    is.pixels.alpha.as_ref().unwrap()
                )
        );
    }
}
