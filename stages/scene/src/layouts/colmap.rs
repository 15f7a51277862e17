//! A COLMAP reconstruction in text: lenses, poses, and points without the images that they were
//! found in. Knows no pictures.
//!
//! Format: <https://colmap.github.io/format.html>.

use std::fmt::Write;

use formats::Camera;
use glam::{DMat3, DQuat};

use super::shot::Shot;
use super::{Capture, LayoutError, Point, lens};

/// The files, by their paths in the scene's folder.
pub(super) fn files(
    shots: &[Shot],
    capture: &Capture,
) -> Result<Vec<(&'static str, String)>, LayoutError> {
    let mut lenses: Vec<String> = Vec::new();
    let mut images = String::new();
    // Numbers begin at 1, as COLMAP's own do.
    for (i, shot) in shots.iter().enumerate() {
        let lens = lens_line(&shot.photo.camera)?;
        // Compared as text: equal lines are one camera to COLMAP.
        let known = lenses.iter().position(|other| *other == lens);
        let lens_number = known.unwrap_or(lenses.len()) + 1;
        if known.is_none() {
            lenses.push(lens);
        }
        let pose = pose(&shot.photo.camera);
        // The second line is for points found in the image, of which there are none.
        let _ = writeln!(images, "{} {pose} {lens_number} {}\n", i + 1, shot.file());
    }
    let cameras = lenses.iter().enumerate();
    let cameras = cameras
        .map(|(i, lens)| format!("{} {lens}\n", i + 1))
        .collect();
    let mut files = vec![
        ("sparse/0/cameras.txt", cameras),
        ("sparse/0/images.txt", images),
        ("sparse/0/points3D.txt", points(capture.points)),
    ];
    if shots.iter().any(|shot| shot.is_test) {
        files.push(("sparse/0/test.txt", test_names(shots)));
    }
    Ok(files)
}

fn lens_line(camera: &Camera) -> Result<String, LayoutError> {
    let (model, parameters) = lens::colmap(camera)?;
    let parameters = words(&parameters);
    Ok(format!(
        "{model} {} {} {parameters}",
        camera.width, camera.height
    ))
}

/// The rotation (w, x, y, z) and translation from the world to COLMAP's camera, whose axes are
/// right, down, forwards.
fn pose(camera: &Camera) -> String {
    let pose = camera.camera_to_world;
    let axes = DMat3::from_cols(
        pose.x_axis.truncate(),
        -pose.y_axis.truncate(),
        -pose.z_axis.truncate(),
    );
    // World to camera is the transpose of our pose's axes, with COLMAP's down and forwards.
    let turn = DQuat::from_mat3(&axes.transpose()).normalize();
    let shift = -(turn * camera.position());
    words(&[turn.w, turn.x, turn.y, turn.z, shift.x, shift.y, shift.z])
}

fn points(points: &[Point]) -> String {
    let mut text = String::new();
    for (i, point) in points.iter().enumerate() {
        let [x, y, z] = point.position;
        let [r, g, b] = point.color;
        // The error of a point that was not triangulated is not known: COLMAP says -1.
        let _ = writeln!(text, "{} {x} {y} {z} {r} {g} {b} -1", i + 1);
    }
    text
}

fn test_names(shots: &[Shot]) -> String {
    let test = shots.iter().filter(|shot| shot.is_test);
    test.map(|shot| format!("{}\n", shot.file())).collect()
}

/// Numbers with all their digits.
fn words(numbers: &[f64]) -> String {
    // Rust prints the shortest decimal that reads back as the same f64.
    let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_that_was_not_triangulated_has_no_error() {
        let point = Point {
            position: [1.0, 2.0, 3.0],
            color: [4, 5, 6],
        };
        assert_eq!(points(&[point]), "1 1 2 3 4 5 6 -1\n");
    }
}
