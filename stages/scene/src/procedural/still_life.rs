//! The embedded still life: things on a table, photographed from an arc of cameras.

use compute::Rng;
use formats::Camera;
use glam::DVec3;

use super::light::Lights;
use super::{photograph, table};
use crate::SceneData;

/// What the cameras look at, and from how far.
const TARGET: DVec3 = DVec3::new(0.0, 0.44, -0.3);
const DISTANCE: f64 = 3.3;
const HEIGHT: f64 = 0.95;
/// The arc reaches this far to either side of straight ahead, in radians.
const HALF_ARC: f64 = 0.45;
/// Focal length over image width (or over 4/3 of the height, if that is more): 37 degrees across.
const FOCAL: f64 = 1.5;
/// Photographs the still life: `views` cameras on an arc, `size` = (width, height) pixels,
/// `samples` x `samples` rays a pixel (4 and more resolve the finest patterns). `seed` turns the
/// things and shifts the cameras a little.
///
/// One unit is about the length of a forearm. All cameras share near and far; these and the box lie
/// as close around the surfaces that are seen as [`SceneData::bounds`] allows. The same arguments
/// give the same bits for any thread count.
///
/// # Panics
/// If `views`, `samples` or a side of `size` is 0: callers check what they are asked for.
pub fn still_life(views: u32, size: (u32, u32), samples: u32, seed: u64) -> SceneData {
    assert!(
        views > 0 && size.0 > 0 && size.1 > 0 && samples > 0,
        "still_life: {views} views, {size:?}, {samples} samples"
    );
    let cameras =
        (0..views).map(|view| (format!("view_{view:03}"), camera(view, views, size, seed)));
    let shot = photograph(
        &table::still_life(seed),
        &Lights::room(),
        cameras.collect(),
        samples,
    );
    SceneData {
        photos: shot.photos,
        test: Vec::new(),
        bounds: shot.bounds,
        description: format!(
            "procedural still life: {views} views of {}x{}, seed {seed}",
            size.0, size.1
        ),
        notes: Vec::new(),
        to_source: glam::DMat4::IDENTITY,
    }
}

/// The cameras go round from left to right, up and down by turns, each a little off its place.
fn camera(view: u32, views: u32, (width, height): (u32, u32), seed: u64) -> Camera {
    // Random numbers of their own, so that things keep their turns when cameras change.
    let rng = Rng::new(seed, "still life: cameras");
    let jitter = |what| f64::from(rng.uniform(view.into(), what)) - 0.5;
    let along = if views > 1 {
        2.0 * f64::from(view) / f64::from(views - 1) - 1.0
    } else {
        0.0
    };
    let angle = HALF_ARC * along + 0.02 * jitter(0);
    let raised = HEIGHT + 0.16 * (2.4 * f64::from(view)).sin() + 0.05 * jitter(1);
    let distance = DISTANCE + 0.1 * jitter(2);
    let position = TARGET + DVec3::new(distance * angle.sin(), raised, distance * angle.cos());
    let focal = FOCAL * f64::from(width).max(f64::from(height) * 4.0 / 3.0);
    Camera::centered(
        (width, height),
        focal,
        Camera::look_at(position, TARGET),
        // Until what rays have met gives near and far.
        [0.0, f64::INFINITY],
    )
}

#[cfg(test)]
mod tests {
    use super::super::world::Line;
    use super::*;
    use glam::Vec3;

    #[test]
    fn no_ray_of_any_camera_leaves_the_world() {
        for (size, seed) in [((256, 192), 0), ((40, 160), 1), ((300, 60), 2)] {
            let world = table::still_life(seed);
            for camera in (0..9).map(|view| camera(view, 9, size, seed)) {
                for step in 0..=60 {
                    let x = f64::from(size.0) * f64::from(step) / 60.0;
                    let y = f64::from(size.1) * f64::from(step) / 60.0;
                    for (px, py) in [
                        (x, 0.0),
                        (x, f64::from(size.1)),
                        (0.0, y),
                        (f64::from(size.0), y),
                    ] {
                        let ray = camera.ray(px, py);
                        let line = Line::new(ray.origin.into(), ray.direction.into());
                        assert!(
                            world.first_hit(&line).is_some(),
                            "{size:?}: nothing at {px}, {py}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_poster_hangs_where_every_photo_shows_it() {
        let scene = still_life(5, (160, 120), 2, 3);
        // Bare paper near the poster's lower left corner, and brick just beside it.
        let paper = [-0.09, 0.62, -1.234];
        let brick = [-0.19, 0.63, -1.25];
        for photo in &scene.photos {
            let color = |point| {
                let [px, py, _] = photo.camera.project(point).unwrap();
                let at = 3 * (py as usize * 160 + px as usize);
                Vec3::from_slice(&photo.pixels.rgb[at..at + 3])
            };
            let paper = color(paper);
            let brick = color(brick);
            assert!(paper.min_element() > 0.7, "{}: {paper}", photo.name);
            assert!(
                brick.z < 0.75 * paper.z && brick.x > brick.z,
                "{}: {brick}",
                photo.name
            );
        }
    }
}
