//! A drawn scene whose truth is known, and what disturbs its photos: something that moves, exposures
//! that differ, poses that are off. Knows no field.

use compute::rng::Rng;
use formats::color::{linear_to_srgb, srgb_to_linear};
use formats::{Bounds, Camera, Pixels};
use glam::{DMat3, DMat4, DQuat, DVec3};
use scene::Photo;

/// The photos to train on, and those that are held out, which nothing disturbs.
pub struct Scene {
    pub train: Vec<Photo>,
    pub held_out: Vec<Photo>,
    pub bounds: Bounds,
}

impl Scene {
    /// The still life; every fourth photo is held out.
    pub fn draw(views: u32, size: (u32, u32)) -> Self {
        let drawn = scene::still_life(views, size, 4, 0);
        let (train, held_out) = scene::split_holdout(drawn.photos, 4);
        Self {
            train,
            held_out,
            bounds: drawn.bounds,
        }
    }
}

/// A number from -1 to 1, the same for every run.
fn random(what: &str, photo: usize, i: u64) -> f64 {
    2.0 * f64::from(Rng::new(7, what).uniform(photo as u64, i)) - 1.0
}

/// A block of flat colour that stands elsewhere in every photo, a fifth of its width; masked.
pub fn with_something_that_moves(photos: &mut [Photo]) {
    for (i, photo) in photos.iter_mut().enumerate() {
        let [width, height] = [photo.camera.width, photo.camera.height];
        let side = width / 5;
        let place = |axis: u64, room: u32| {
            (0.5 * (random("moves", i, axis) + 1.0) * f64::from(room)) as u32
        };
        let left = place(0, width - side);
        let top = place(1, height - side);
        let mut mask = vec![true; (width * height) as usize];
        for pixel in 0..width * height {
            let [x, y] = [pixel % width, pixel / width];
            if (left..left + side).contains(&x) && (top..top + side).contains(&y) {
                let at = pixel as usize;
                mask[at] = false;
                photo.pixels.rgb[3 * at..3 * at + 3].copy_from_slice(&[0.9, 0.1, 0.6]);
            }
        }
        photo.mask = Some(mask);
    }
}

/// Up to a stop more or less light, and a twentieth of it more or less in each channel.
pub fn with_exposures(photos: &mut [Photo]) {
    for (i, photo) in photos.iter_mut().enumerate() {
        let stops = random("exposure", i, 0);
        let gain = [1, 2, 3].map(|c| ((stops + 0.07 * random("exposure", i, c)).exp2()) as f32);
        let values = photo.pixels.rgb.iter().enumerate();
        let rgb = values
            .map(|(at, x)| linear_to_srgb(srgb_to_linear(*x) * gain[at % 3]).clamp(0.0, 1.0))
            .collect();
        photo.pixels = Pixels::new(rgb, photo.pixels.alpha.clone());
    }
}

/// Cameras turned by up to a hundredth of a radian about each axis, and shifted by up to a hundredth
/// of their distance along each.
pub fn with_poses_off(photos: &mut [Photo]) {
    for (i, photo) in photos.iter_mut().enumerate() {
        let three =
            |first: u64| DVec3::from([0, 1, 2].map(|a| 0.01 * random("poses", i, first + a)));
        let camera = &photo.camera;
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(three(0)));
        let mut pose = DMat4::from_mat3(turn * DMat3::from_mat4(camera.camera_to_world));
        let shift = (camera.near * camera.far).sqrt() * three(3);
        pose.w_axis = (camera.position() + shift).extend(1.0);
        photo.camera = Camera {
            camera_to_world: pose,
            ..*camera
        };
    }
}
