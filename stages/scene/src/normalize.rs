//! Moves a scene into coordinates of its own cameras. Knows nothing of files.

use formats::Camera;
use glam::{DMat3, DMat4, DVec3};

/// Brings cameras into a frame where numbers are tame: the average camera stands at the origin,
/// looks along -z with +y up, and the nearest near plane lies at depth 1.
///
/// It is a similarity (a rotation, a translation, one scale), so shapes and angles stay as they
/// are. The turn makes an axis-aligned scene box hug what forward-facing cameras see, so that a
/// hash grid wastes no cells; the scale makes near, far and step sizes comparable between scenes,
/// whatever unit the pose estimation chose.
///
/// Also gives the matrix that takes the new coordinates back to the old ones.
pub(crate) fn normalize(cameras: &[Camera]) -> (Vec<Camera>, DMat4) {
    // A reconstruction's unit is arbitrary, so the nearest near plane gives another.
    let nearest = cameras
        .iter()
        .map(|camera| camera.near)
        .fold(f64::INFINITY, f64::min);
    let average = average_pose(cameras);
    let to_average = average.inverse();
    let moved = cameras
        .iter()
        .map(|camera| camera.moved(to_average, 1.0 / nearest))
        .collect();
    (moved, average * DMat4::from_scale(DVec3::splat(nearest)))
}

/// The mean position and the mean viewing and up directions, made orthonormal. Where those cancel
/// out, as for cameras all around a scene, any directions serve.
pub(crate) fn average_pose(cameras: &[Camera]) -> DMat4 {
    let sum = |axis: fn(&DMat4) -> DVec3| {
        cameras
            .iter()
            .map(|camera| axis(&camera.camera_to_world))
            .sum::<DVec3>()
    };
    // Directions, and not rotations, are averaged: only the view axis and the upright matter.
    let back = sum(|pose| pose.z_axis.truncate())
        .try_normalize()
        .unwrap_or(DVec3::Z);
    // Not made upright first: only the plane of up and back matters.
    let up = sum(|pose| pose.y_axis.truncate());
    let right = up
        .cross(back)
        .try_normalize()
        .unwrap_or_else(|| back.any_orthonormal_vector());
    let position = sum(|pose| pose.w_axis.truncate()) / cameras.len().max(1) as f64;
    // `back x right` is up again, at right angles to both.
    DMat4::from_mat3_translation(DMat3::from_cols(right, back.cross(right), back), position)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(position: DVec3, target: DVec3, near: f64) -> Camera {
        Camera::centered(
            (40, 30),
            50.0,
            Camera::look_at(position, target),
            [near, 9.0 * near],
        )
    }

    fn arc() -> Vec<Camera> {
        let target = DVec3::new(70.0, 10.0, -30.0);
        let offsets = [
            DVec3::new(-3.0, 4.0, 20.0),
            DVec3::new(0.0, 5.0, 21.0),
            DVec3::new(4.0, 3.0, 19.0),
        ];
        offsets
            .iter()
            .enumerate()
            .map(|(i, offset)| camera(target + offset, target, 8.0 + i as f64))
            .collect()
    }

    #[test]
    fn the_average_camera_comes_to_the_origin_and_the_nearest_plane_to_one() {
        let cameras = normalize(&arc()).0;
        let mean = cameras.iter().map(Camera::position).sum::<DVec3>() / 3.0;
        assert!(mean.length() < 1e-12, "{mean}");
        let looking = cameras
            .iter()
            .map(|c| c.camera_to_world.z_axis.truncate())
            .sum::<DVec3>()
            .normalize();
        assert!(looking.distance(DVec3::Z) < 1e-12, "{looking}");
        assert_eq!(cameras[0].near, 1.0);
        assert!((cameras[2].far - 90.0 / 8.0).abs() < 1e-12);
    }

    #[test]
    fn what_a_camera_sees_stays_in_its_place() {
        let before = arc();
        let after = normalize(&arc()).0;
        let points = before.iter().map(|c| c.unproject(7.0, 21.0, 12.0));
        let moved: Vec<_> = after
            .iter()
            .map(|c| c.unproject(7.0, 21.0, 12.0 / 8.0))
            .collect();
        for (point, moved) in points.zip(moved) {
            for (a, b) in before.iter().zip(&after) {
                let was = a.project(point).unwrap();
                let is = b.project(moved).unwrap();
                assert!(
                    (was[0] - is[0]).abs() < 1e-9 && (was[1] - is[1]).abs() < 1e-9,
                    "{was:?} {is:?}"
                );
                assert!(
                    (was[2] / 8.0 - is[2]).abs() < 1e-9,
                    "depth is scaled like near and far"
                );
            }
        }
    }

    #[test]
    fn the_matrix_leads_back() {
        let cameras = arc();
        let (moved, back) = normalize(&cameras);
        for (was, is) in cameras.iter().zip(&moved) {
            let returned = back.transform_point3(is.position());
            assert!(returned.distance(was.position()) < 1e-9, "{returned}");
        }
    }

    #[test]
    fn cameras_that_look_at_each_other_still_get_a_frame() {
        let facing = [
            camera(DVec3::Z, DVec3::ZERO, 1.0),
            camera(-DVec3::Z, DVec3::ZERO, 1.0),
        ];
        for camera in normalize(&facing).0 {
            assert!(camera.camera_to_world.is_finite());
            assert!((camera.camera_to_world.determinant() - 1.0).abs() < 1e-9);
        }
    }
}
