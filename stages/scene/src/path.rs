//! Paths for a camera to fly, made from the cameras that took the photos. Knows nothing of what is
//! seen on the way.

use std::f64::consts::TAU;
use std::path::Path;

use formats::Camera;
use glam::DVec3;

use crate::normalize::average_pose;
use crate::{SceneError, pose, source_files, transforms};

/// The part of the cameras' spread that a spiral fills: what they really saw lies inside.
const SPREAD: f64 = 0.8;
/// A spiral goes forwards and backwards by this part of its width.
const ALONG: f64 = 0.3;

/// `frames` cameras on a spiral about the average camera, as wide as the cameras stand apart,
/// looking at what all of them look at: for scenes photographed from one side. It closes after
/// `turns` turns.
///
/// # Panics
/// If there are no cameras.
pub fn spiral(cameras: &[Camera], frames: u32, turns: f64) -> Vec<Camera> {
    let average = average_pose(cameras);
    let to_average = average.inverse();
    let reach = cameras
        .iter()
        .map(|camera| to_average.transform_point3(camera.position()).abs())
        .fold(DVec3::ZERO, DVec3::max);
    let focus = pose::focus(cameras);
    let up = average.y_axis.truncate();
    let place = |part: f64| {
        let angle = TAU * turns * part;
        // Forwards and backwards once, whatever the number of turns, so that the path closes.
        let ahead = ALONG * reach.truncate().length() * (TAU * part).sin();
        let offset = SPREAD * DVec3::new(reach.x * angle.cos(), reach.y * angle.sin(), ahead);
        Camera::look_at_with_up(average.transform_point3(offset), focus, up)
    };
    along(cameras, frames, place)
}

/// `frames` cameras on a circle around what all cameras look at, as far and as high as these stand
/// on average: for objects photographed from all around.
///
/// # Panics
/// If there are no cameras.
pub fn circle(cameras: &[Camera], frames: u32) -> Vec<Camera> {
    let focus = pose::focus(cameras);
    let count = cameras.len() as f64;
    let up = upwards(cameras);
    let offset = |camera: &Camera| camera.position() - focus;
    let height = cameras
        .iter()
        .map(|camera| offset(camera).dot(up))
        .sum::<f64>()
        / count;
    let distance = cameras
        .iter()
        .map(|camera| offset(camera).length())
        .sum::<f64>()
        / count;
    // Not straight above, where there would be no circle.
    let height = height.clamp(-0.9 * distance, 0.9 * distance);
    let radius = (distance * distance - height * height).sqrt();
    // It starts at the first camera's side.
    let side = offset(&cameras[0]).reject_from_normalized(up);
    let side = side
        .try_normalize()
        .unwrap_or_else(|| up.any_orthonormal_vector());
    let other = up.cross(side);
    let place = |part: f64| {
        let (sin, cos) = (TAU * part).sin_cos();
        Camera::look_at_with_up(
            focus + height * up + radius * (cos * side + sin * other),
            focus,
            up,
        )
    };
    along(cameras, frames, place)
}

/// The direction that the cameras' sides are at right angles to, as photographers hold them: better
/// than the mean of their own upward directions, which leans to where more of them stand. Of the
/// directions that serve, the nearest to that mean.
///
/// # Panics
/// If there are no cameras.
pub fn upwards(cameras: &[Camera]) -> DVec3 {
    const STEPS: usize = 64;
    let mean = cameras
        .iter()
        .map(|camera| camera.camera_to_world.y_axis.truncate())
        .sum::<DVec3>();
    let sideways = |direction: DVec3| -> DVec3 {
        let sides = cameras
            .iter()
            .map(|camera| camera.camera_to_world.x_axis.truncate());
        sides.map(|side| side * side.dot(direction)).sum::<DVec3>() / cameras.len() as f64
    };
    // Power iteration for the least eigenvalue of the mean of side sideᵀ, whose eigenvalues are 0
    // to 1.
    let start = mean.try_normalize().unwrap_or(DVec3::Y);
    // Taking that matrix off turns its least eigenvalue into the largest, which iteration finds.
    (0..STEPS).fold(start, |up, _| {
        (up - sideways(up)).try_normalize().unwrap_or(up)
    })
}

/// The cameras of a `transforms.json`, in its order and in the scene's own coordinates. What it
/// does not say of size, near and far is the first camera's.
///
/// # Errors
/// A file that is not such a file, by name and field.
///
/// # Panics
/// If there are no cameras.
pub fn path_from_file(path: &Path, cameras: &[Camera]) -> Result<Vec<Camera>, SceneError> {
    transforms::cameras_of_file(path, &with_all_depths(cameras))
}

/// The text of a file from which [`path_from_file`] reads these cameras, to the last bit.
pub fn path_text(cameras: &[Camera]) -> String {
    let frames: Vec<serde_json::Value> = cameras
        .iter()
        .enumerate()
        .map(|(i, camera)| transforms::frame(&format!("frame_{i:04}"), camera))
        .collect();
    format!("{:#}\n", serde_json::json!({ "frames": frames }))
}

/// A digest over a file for [`path_from_file`], which is read to see whether it can be flown.
///
/// # Errors
/// Those of [`path_from_file`].
pub fn path_digest(path: &Path) -> Result<[u8; 32], SceneError> {
    // What a file leaves out is the scene's; any camera stands for it here.
    let like = Camera::centered((64, 48), 60.0, glam::DMat4::IDENTITY, [1.0, 2.0]);
    transforms::cameras_of_file(path, &like)?;
    Ok(*source_files::content_digest(path)?.as_bytes())
}

/// Cameras like the first one, with poses by the part of the way that lies behind them.
fn along(cameras: &[Camera], frames: u32, place: impl Fn(f64) -> glam::DMat4) -> Vec<Camera> {
    let like = with_all_depths(cameras);
    let camera = |frame| Camera {
        // Divided by `frames`, not by `frames - 1`: the last frame precedes the first in a loop.
        camera_to_world: place(f64::from(frame) / f64::from(frames)),
        ..like
    };
    (0..frames).map(camera).collect()
}

/// The first camera as a pinhole, from the nearest near to the farthest far of all.
fn with_all_depths(cameras: &[Camera]) -> Camera {
    let near = cameras
        .iter()
        .map(|camera| camera.near)
        .fold(f64::INFINITY, f64::min);
    let far = cameras.iter().map(|camera| camera.far).fold(0.0, f64::max);
    Camera {
        near,
        far,
        // Paths are pinholes: a lens would bend frames that nobody photographed.
        distortion: Default::default(),
        ..cameras[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> Vec<Camera> {
        crate::object(12, (8, 8), 1, 0)
            .photos
            .into_iter()
            .map(|photo| photo.camera)
            .collect()
    }

    #[test]
    fn a_circle_goes_once_around_what_all_look_at() {
        let path = circle(&ring(), 8);
        let positions: Vec<DVec3> = path.iter().map(Camera::position).collect();
        let middle = positions.iter().sum::<DVec3>() / 8.0;
        assert!(
            middle.truncate().length() < 0.3 && middle.z > 0.3,
            "above the object: {middle}"
        );
        for camera in &path {
            let [px, py, depth] = camera.project([0.0; 3]).unwrap();
            assert!((px - 4.0).abs() < 0.8 && (py - 4.0).abs() < 0.8 && (depth - 4.03).abs() < 0.3);
            let above = camera.project([0.0, 0.0, 0.3]).unwrap();
            assert!(above[1] < py, "up is up");
        }
        let steps = (0..8).map(|i| positions[i].distance(positions[(i + 1) % 8]));
        let [least, most] = steps.fold([f64::INFINITY, 0.0], |[a, b], d| {
            [f64::min(a, d), f64::max(b, d)]
        });
        assert!(
            most / least < 1.01,
            "even steps, and closed: {least} {most}"
        );
    }

    #[test]
    fn a_spiral_stays_among_the_cameras_and_closes() {
        let cameras: Vec<Camera> = crate::still_life(5, (8, 6), 1, 0)
            .photos
            .into_iter()
            .map(|photo| photo.camera)
            .collect();
        let path = spiral(&cameras, 30, 2.0);
        let apart = |a: &Camera, b: &Camera| a.position().distance(b.position());
        let widest = cameras
            .iter()
            .map(|camera| apart(camera, &cameras[0]))
            .fold(0.0, f64::max);
        let step = (1..30)
            .map(|i| apart(&path[i - 1], &path[i]))
            .fold(0.0, f64::max);
        assert!(apart(&path[29], &path[0]) <= 1.5 * step, "it closes");
        for camera in &path {
            assert!(
                cameras
                    .iter()
                    .all(|other| apart(camera, other) <= 1.1 * widest)
            );
            assert_eq!((camera.near, camera.far), (cameras[0].near, cameras[0].far));
            let seen = camera.project([0.0, 0.44, -0.3]).unwrap();
            assert!(
                (0.0..8.0).contains(&seen[0]) && (0.0..6.0).contains(&seen[1]),
                "the table is in view: {seen:?}"
            );
        }
    }

    #[test]
    fn a_path_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        let mut cameras = ring();
        cameras[1].distortion.k1 = 0.01;
        std::fs::write(&path, path_text(&cameras)).unwrap();
        assert_eq!(path_from_file(&path, &ring()).unwrap(), cameras);
    }

    #[test]
    fn poses_from_a_file_keep_their_order_and_take_the_rest_from_the_scene() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        let turn = |x: f64| {
            [
                [1.0, 0.0, 0.0, x],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ]
        };
        let frames = [3.0, 1.0, 2.0]
            .map(|x| serde_json::json!({"file_path": "", "transform_matrix": turn(x)}));
        std::fs::write(
            &path,
            serde_json::json!({"fl_x": 9.0, "frames": frames}).to_string(),
        )
        .unwrap();
        let cameras = ring();
        let read = path_from_file(&path, &cameras).unwrap();
        assert_eq!(
            read.iter()
                .map(|camera| camera.position().x)
                .collect::<Vec<_>>(),
            [3.0, 1.0, 2.0]
        );
        assert_eq!(
            (read[0].width, read[0].fl_x, read[0].near),
            (8, 9.0, cameras[0].near)
        );
        assert!(path_from_file(&folder.path().join("gone.json"), &cameras).is_err());
    }
}
