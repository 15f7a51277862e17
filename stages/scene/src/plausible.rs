//! Whether cameras together can be those of one scene: one far from all others, all at one place,
//! all far from the origin. Knows no files.

use formats::Camera;
use glam::{DMat4, DVec3};

use crate::faults::a_tenth;

/// A camera this many times as far away as nine tenths of them is taken for a mistake of the pose
/// estimation.
const STRAY: f64 = 10.0;
/// Cameras that stand closer together than this part of their distance from the origin stand at one
/// place.
const ONE_PLACE: f64 = 1e-9;
/// Coordinates are moved if the cameras stand this many times as far from the origin as from each
/// other.
const FAR_OFF: f64 = 1e3;

/// Where cameras stand: the middle of them, and how far nine tenths of them are from it.
struct Crowd {
    middle: DVec3,
    distances: Vec<f64>,
    reach: f64,
}

impl Crowd {
    fn of(cameras: &[Camera]) -> Self {
        // Medians: the strays that are looked for must not move the middle.
        let middle_of = |axis: usize| {
            let along = cameras.iter().map(|camera| camera.position()[axis]);
            sorted(along).get(cameras.len() / 2).copied().unwrap_or(0.0)
        };
        let middle = DVec3::new(middle_of(0), middle_of(1), middle_of(2));
        let distances: Vec<f64> = cameras
            .iter()
            .map(|camera| camera.position().distance(middle))
            .collect();
        // Nine tenths of the cameras, so that a tenth may be strays.
        let at = cameras.len().saturating_sub(1) * 9 / 10;
        let reach = sorted(distances.iter().copied())
            .get(at)
            .copied()
            .unwrap_or(0.0);
        Self {
            middle,
            distances,
            reach,
        }
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// A camera far from all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stray {
    /// Its index among the cameras.
    pub(crate) index: usize,
    /// How many times as far away as nine tenths of the cameras.
    pub(crate) times: f64,
}

/// Cameras far from all others, and whether they are few enough to do without them.
pub(crate) fn strays(cameras: &[Camera]) -> (Vec<Stray>, bool) {
    let crowd = Crowd::of(cameras);
    let far = |(index, distance): (usize, &f64)| {
        let times = distance / crowd.reach;
        // With most cameras at one place the reach is 0, and nothing can be said of the others.
        (times.is_finite() && times > STRAY).then_some(Stray { index, times })
    };
    let strays: Vec<Stray> = crowd.distances.iter().enumerate().filter_map(far).collect();
    let few = strays.len() <= a_tenth(cameras.len());
    (strays, few)
}

/// Whether several cameras stand at one place, from which nobody can tell how far anything is.
pub(crate) fn at_one_place(cameras: &[Camera]) -> bool {
    let crowd = Crowd::of(cameras);
    let farthest = crowd.distances.iter().copied().fold(0.0, f64::max);
    // Relative to the distance from the origin, with which rounding grows.
    cameras.len() > 1 && farthest <= ONE_PLACE * crowd.middle.length()
}

/// For cameras so far from the origin that single precision would blur them (georeferenced ones,
/// say): the matrix that takes coordinates about their middle, in units of their spread, to the
/// ones they have. `None` for all others.
pub(crate) fn recentred(cameras: &[Camera]) -> Option<DMat4> {
    let crowd = Crowd::of(cameras);
    let far = crowd.reach > 0.0 && crowd.middle.abs().max_element() > FAR_OFF * crowd.reach;
    far.then(|| {
        // Scaled by the reach as well: distances between cameras are then about 1.
        DMat4::from_translation(crowd.middle) * DMat4::from_scale(DVec3::splat(crowd.reach))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: u32, about: DVec3) -> Vec<Camera> {
        let camera = |i| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(count);
            let position = about + 3.0 * DVec3::new(angle.cos(), 0.1, angle.sin());
            Camera::centered((8, 8), 9.0, Camera::look_at(position, about), [1.0, 6.0])
        };
        (0..count).map(camera).collect()
    }

    #[test]
    fn one_camera_a_hundred_times_as_far_away_is_a_stray() {
        let mut cameras = ring(24, DVec3::ZERO);
        assert_eq!(strays(&cameras), (vec![], true));
        cameras[7].camera_to_world.w_axis *= 100.0;
        let (found, few) = strays(&cameras);
        assert!(few && found.len() == 1 && found[0].index == 7 && found[0].times > 50.0);
    }

    #[test]
    fn cameras_at_one_place_are_told_from_close_ones() {
        let place = DVec3::new(5.0, 6.0, 7.0);
        let mut cameras = ring(9, place);
        assert!(!at_one_place(&cameras));
        for camera in &mut cameras {
            camera.camera_to_world.w_axis = place.extend(1.0);
        }
        assert!(at_one_place(&cameras) && !at_one_place(&cameras[..1]));
    }

    #[test]
    fn georeferenced_cameras_are_moved_to_the_origin() {
        assert_eq!(recentred(&ring(9, DVec3::new(40.0, 25.0, 3.0))), None);
        let cameras = ring(9, DVec3::new(448_262.0, 5_411_932.0, 480.0));
        let back = recentred(&cameras).unwrap();
        let moved = back.inverse().transform_point3(cameras[0].position());
        assert!(moved.length() < 3.0, "{moved}");
        assert!(back.transform_point3(moved).distance(cameras[0].position()) < 1e-8);
    }
}
