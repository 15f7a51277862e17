//! The embedded object: a small monument before nothing, photographed from all around as
//! NeRF-synthetic's objects are.

use compute::Rng;
use formats::{Camera, bounds};
use glam::{DMat4, DVec3, DVec4};

use super::light::Lights;
use super::{photograph, sculpture};
use crate::{Photo, SceneData};

/// The cameras' distance from the origin and their field of view across, those of NeRF-synthetic.
// NeRF-synthetic's, to the last digit.
const DISTANCE: f64 = 4.031128874;
const FIELD_OF_VIEW: f64 = 0.6911112070083618;
/// Training photos are held out for testing, beside others of their own, one for so many.
const TRAIN_PER_TEST: u32 = 4;
/// From the tracer's axes (y up) to those of NeRF-synthetic (z up): columns.
const Z_UP: DMat4 = DMat4::from_cols(
    DVec4::X,
    DVec4::Z,
    DVec4::new(0.0, -1.0, 0.0, 0.0),
    DVec4::W,
);

/// How many photos [`object`] sets aside for testing beside so many for training.
pub fn object_tests(views: u32) -> u32 {
    views.div_ceil(TRAIN_PER_TEST)
}

/// Photographs the object on nothing: `views` cameras for training at random places of a half
/// sphere, and a fourth as many for testing on a spiral over it. `size` = (width, height) pixels,
/// `samples` x `samples` rays a pixel.
///
/// Photos have alpha. The world is that of NeRF-synthetic: the object about the origin, z up. All
/// cameras share near and far. The same arguments give the same bits for any thread count.
///
/// # Panics
/// If `views`, `samples` or a side of `size` is 0: callers check what they are asked for.
pub fn object(views: u32, size: (u32, u32), samples: u32, seed: u64) -> SceneData {
    assert!(
        views > 0 && size.0 > 0 && size.1 > 0 && samples > 0,
        "object: {views} views, {size:?}, {samples} samples"
    );
    let tests = object_tests(views);
    let train =
        (0..views).map(|view| (format!("train_{view:03}"), camera(place(view, seed), size)));
    let test = (0..tests).map(|view| {
        (
            format!("test_{view:03}"),
            camera(on_spiral(view, tests), size),
        )
    });
    let shot = photograph(
        &sculpture::sculpture(),
        &Lights::around(),
        train.chain(test).collect(),
        samples,
    );
    let mut photos: Vec<Photo> = shot
        .photos
        .into_iter()
        .map(|photo| Photo {
            // Traced with y up, as lights and things are placed; turned at the very end.
            camera: photo.camera.moved(Z_UP, 1.0),
            ..photo
        })
        .collect();
    let test = photos.split_off(views as usize);
    SceneData {
        photos,
        test,
        // Turned corners are no longer the lowest and the highest, so the box is taken anew.
        bounds: bounds::around(
            shot.bounds
                .map(|corner| Z_UP.transform_point3(DVec3::from(corner)).to_array()),
        ),
        description: format!(
            "procedural object: {views} and {tests} views of {}x{}, seed {seed}",
            size.0, size.1
        ),
        notes: Vec::new(),
        to_source: glam::DMat4::IDENTITY,
    }
}

/// A random direction, evenly over the upper half of the sphere, but for its very top, where up is
/// nowhere.
fn place(view: u32, seed: u64) -> DVec3 {
    let rng = Rng::new(seed, "object: cameras");
    // By view and purpose: more views leave the first ones where they are.
    let random = |what| f64::from(rng.uniform(view.into(), what));
    direction(random(0), 0.98 * random(1))
}

/// Once around, rising and falling.
fn on_spiral(view: u32, views: u32) -> DVec3 {
    let along = (f64::from(view) + 0.5) / f64::from(views);
    direction(
        along,
        0.45 + 0.35 * (3.0 * std::f64::consts::TAU * along).sin(),
    )
}

/// The unit vector at a part of a turn around, with its height over the ground.
fn direction(turn: f64, height: f64) -> DVec3 {
    let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
    // Even in height is even on the sphere (Archimedes).
    let out = (1.0 - height * height).sqrt();
    DVec3::new(out * cos, height, out * sin)
}

fn camera(from: DVec3, (width, height): (u32, u32)) -> Camera {
    // Over the shorter side, so that the object is whole in pictures of any shape.
    let focal = 0.5 * f64::from(width.min(height)) / (0.5 * FIELD_OF_VIEW).tan();
    Camera::centered(
        (width, height),
        focal,
        Camera::look_at(DISTANCE * from, DVec3::ZERO),
        [0.0, f64::INFINITY],
    )
}
