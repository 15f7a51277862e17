//! Checks foreign poses and gives them a scene to stand in where their files name none. Knows no
//! formats.

use formats::{Bounds, Camera, bounds};
use glam::{DMat3, DMat4, DVec3};

/// Rotations farther than this from orthonormal are not rotations. Files in single precision are
/// within 1e-6.
const ORTHONORMAL: f64 = 1e-3;
/// Nothing is nearer to a camera inside the box than this part of the box's longest side.
const NEAREST: f64 = 0.025;
/// Near and far where only the cameras are known, in distances to what they look at.
const GUESS: [f64; 2] = [0.1, 3.0];

/// A camera-to-world matrix from its rows, after checking that it is a rotation and a translation.
/// A uniform scale, as some tools leave in the rotation, is taken out.
///
/// # Errors
/// What is wrong with the matrix, after its name.
pub fn rigid(rows: &[[f64; 4]]) -> Result<DMat4, String> {
    if rows.as_flattened().iter().any(|value| !value.is_finite()) {
        return Err("holds a number that is not finite".into());
    }
    // Tolerant, since some files hold single precision.
    let is_last = |row: &[f64; 4]| {
        let off = |(value, wanted): (&f64, f64)| (value - wanted).abs() <= ORTHONORMAL;
        row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(off)
    };
    if !(3..=4).contains(&rows.len()) || !rows.get(3).is_none_or(is_last) {
        return Err("is not a 4x4 matrix with the last row 0 0 0 1".into());
    }
    let column = |i: usize| DVec3::new(rows[0][i], rows[1][i], rows[2][i]);
    let turn = DMat3::from_cols(column(0), column(1), column(2));
    // Some programs scale poses with the scene; an even scale is taken out.
    let scale = turn.determinant().max(0.0).cbrt();
    if scale == 0.0 {
        return Err("mirrors or flattens space; expected a rotation".into());
    }
    // Within single precision it is kept as it is, to the last bit.
    let turn = if (scale - 1.0).abs() < 1e-5 {
        turn
    } else {
        turn * (1.0 / scale)
    };
    let product = turn.transpose() * turn;
    let turns = product.abs_diff_eq(DMat3::IDENTITY, ORTHONORMAL);
    if !turns {
        return Err(
            "has columns that are not at right angles and of one length; expected a rotation"
                .into(),
        );
    }
    Ok(DMat4::from_mat3_translation(turn, column(3)))
}

/// Refuses what cannot be a camera, by what is wrong with it.
pub(crate) fn check(camera: &Camera) -> Result<(), String> {
    let lens = [camera.fl_x, camera.fl_y, camera.cx, camera.cy];
    if lens.iter().any(|value| !value.is_finite()) || camera.fl_x <= 0.0 || camera.fl_y <= 0.0 {
        return Err(format!(
            "its focal lengths {} and {} must be above 0, and its principal point ({}, {}) finite",
            camera.fl_x, camera.fl_y, camera.cx, camera.cy
        ));
    }
    // A crop may put it outside of the image, but not by more than an image.
    let outside = |at: f64, side: u32| at < -f64::from(side) || at > 2.0 * f64::from(side);
    if outside(camera.cx, camera.width) || outside(camera.cy, camera.height) {
        return Err(format!(
            "its principal point ({}, {}) lies far outside its {}x{} pixels: is it for photos of another size?",
            camera.cx, camera.cy, camera.width, camera.height
        ));
    }
    // Where the lens folds, one pixel has several rays, and undoing the formula finds any of them.
    match camera.sees_through_its_image() {
        true => Ok(()),
        false => Err(format!(
            "its lens ({}) folds the image over before its rim: check the coefficients, or undistort the photos first",
            camera.distortion
        )),
    }
}

/// The depths along the view axis between which a camera meets a box.
pub(crate) fn depths_of_box(camera: &Camera, bounds: &Bounds) -> [f64; 2] {
    let to_camera = camera.camera_to_world.inverse();
    // Bit `axis` of i chooses the low or the high corner of that axis.
    let corner = |i: usize| [0, 1, 2].map(|axis| bounds[i >> axis & 1][axis]);
    let depths = (0..8).map(|i| -to_camera.transform_point3(corner(i).into()).z);
    let [least, most] = depths.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], d| {
        [a.min(d), b.max(d)]
    });
    let longest = (0..3)
        .map(|axis| bounds[1][axis] - bounds[0][axis])
        .fold(0.0, f64::max);
    let near = least.max(NEAREST * longest);
    // A camera that looks away from the box sees nothing of it; its range must still be one.
    [near, if most > near { most } else { 2.0 * near }]
}

/// Whether a camera sees something of a box: one of a grid of its rays meets the box in front of
/// it, or the box is so small that its middle lies between them.
pub(crate) fn sees_box(camera: &Camera, bounds: &Bounds) -> bool {
    const GRID: u32 = 16;
    let middle = [0, 1, 2].map(|axis| 0.5 * (bounds[0][axis] + bounds[1][axis]));
    let width = f64::from(camera.width);
    let height = f64::from(camera.height);
    let in_image =
        |[px, py, _]: [f64; 3]| (0.0..=width).contains(&px) && (0.0..=height).contains(&py);
    if camera.project(middle).is_some_and(in_image) {
        return true;
    }
    let at = |i: u32| f64::from(i) / f64::from(GRID);
    (0..=GRID).any(|j| (0..=GRID).any(|i| meets(camera, at(i) * width, at(j) * height, bounds)))
}

/// Whether the ray through a point of the image meets a box.
fn meets(camera: &Camera, px: f64, py: f64, bounds: &Bounds) -> bool {
    let origin = camera.position();
    let along = DVec3::from(camera.unproject(px, py, 1.0)) - origin;
    let mut first = 0.0;
    let mut last = f64::INFINITY;
    for axis in 0..3 {
        let cuts = [0, 1].map(|side: usize| (bounds[side][axis] - origin[axis]) / along[axis]);
        // A ray within a face gives no number there, which `max` and `min` pass over.
        first = f64::max(first, cuts[0].min(cuts[1]));
        last = f64::min(last, cuts[0].max(cuts[1]));
    }
    first <= last
}

/// Near and far for cameras of which nothing else is known: around the point that all of them look
/// at.
pub(crate) fn guess_depths(cameras: &[Camera]) -> [f64; 2] {
    let focus = focus(cameras);
    let mut distances: Vec<f64> = cameras
        .iter()
        .map(|camera| camera.position().distance(focus))
        .collect();
    distances.sort_by(f64::total_cmp);
    let middle = distances
        // The median: a camera far away must not stretch the range of all.
        .get(distances.len() / 2)
        .copied()
        .filter(|d| *d > 0.0)
        .unwrap_or(1.0);
    GUESS.map(|factor| factor * middle)
}

/// The point with the least squared distance to all view axes; for parallel axes, some point on
/// them.
pub fn focus(cameras: &[Camera]) -> DVec3 {
    let mut matrix = DMat3::ZERO;
    let mut right = DVec3::ZERO;
    for camera in cameras {
        let axis = camera.camera_to_world.z_axis.truncate();
        // I - a a^T keeps what is across the axis: the system is that of the point nearest to all
        // axes.
        let across =
            DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        matrix += across;
        right += across * camera.position();
    }
    let count = cameras.len().max(1) as f64;
    // Of one camera, or of parallel ones, the system says nothing about the depth: this much, from
    // their spread, does.
    let mean = cameras.iter().map(Camera::position).sum::<DVec3>() / count;
    let ahead = cameras
        .iter()
        .map(|camera| -camera.camera_to_world.z_axis.truncate())
        .sum::<DVec3>()
        / count;
    let spread = cameras
        .iter()
        .map(|camera| camera.position().distance(mean))
        .fold(0.0, f64::max);
    // Ahead of the mean camera, by three times the spread: what captures usually look at.
    let prior = mean + ahead * if spread > 0.0 { 3.0 * spread } else { 1.0 };
    // Small, so that it hardly moves a focus that the axes determine.
    let weight = 1e-4 * count;
    (matrix + DMat3::from_diagonal(DVec3::splat(weight))).inverse() * (right + weight * prior)
}

/// The box around all that the cameras see between their near and far.
pub(crate) fn hull(cameras: &[Camera]) -> Bounds {
    bounds::around(cameras.iter().flat_map(Camera::frustum_corners))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looking(position: DVec3, target: DVec3) -> Camera {
        Camera::centered(
            (40, 30),
            50.0,
            Camera::look_at(position, target),
            [0.0, 1.0],
        )
    }

    #[test]
    fn cameras_around_a_point_look_at_it() {
        let target = DVec3::new(3.0, -2.0, 5.0);
        let positions = [
            DVec3::new(4.0, 0.0, 0.5),
            DVec3::new(-4.0, 1.0, 0.0),
            DVec3::new(0.3, 0.0, 4.0),
        ];
        let cameras = positions.map(|offset| looking(target + offset, target));
        assert!(
            focus(&cameras).distance(target) < 0.01,
            "{}",
            focus(&cameras)
        );
        let [near, far] = guess_depths(&cameras);
        assert!(
            (near - 0.4).abs() < 0.02 && (far - 12.0).abs() < 0.5,
            "{near} {far}"
        );
        let [near, far] = guess_depths(&cameras[..1]);
        assert!(
            0.0 < near && near < far && far.is_finite(),
            "one camera alone: {near} {far}"
        );
    }

    #[test]
    fn a_box_lies_between_its_corners_depths() {
        let cube = [[-1.0; 3], [1.0; 3]];
        assert_eq!(
            depths_of_box(&looking(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO), &cube),
            [3.0, 5.0]
        );
        assert_eq!(
            depths_of_box(&looking(DVec3::ZERO, -DVec3::Z), &cube),
            [0.05, 1.0],
            "from within"
        );
        let [near, far] = depths_of_box(
            &looking(DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.0, 0.0, 9.0)),
            &cube,
        );
        assert!(0.0 < near && near < far, "looking away: {near} {far}");
    }

    #[test]
    fn a_box_is_seen_or_not() {
        let cube = [[-1.0; 3], [1.0; 3]];
        let from = |position: DVec3, target: DVec3| sees_box(&looking(position, target), &cube);
        assert!(from(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO));
        assert!(from(DVec3::ZERO, DVec3::X), "from within");
        assert!(
            from(DVec3::new(0.0, 0.0, 4.0), DVec3::new(1.5, 0.0, 0.0)),
            "in part"
        );
        assert!(from(DVec3::new(0.0, 0.0, 900.0), DVec3::ZERO), "far away");
        assert!(!from(DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.0, 0.0, 9.0)));
    }

    #[test]
    fn only_rotations_are_poses_but_a_scale_is_forgiven() {
        let pose = |x: f64| {
            [
                [x, 0.0, 0.0, 1.0],
                [0.0, x, 0.0, 2.0],
                [0.0, 0.0, x, 3.0],
                [0.0, 0.0, 0.0, 1.0],
            ]
        };
        assert_eq!(rigid(&pose(2.0)), rigid(&pose(1.0)));
        let fault = |change: &dyn Fn(&mut [[f64; 4]; 4])| {
            let mut rows = pose(1.0);
            change(&mut rows);
            rigid(&rows).unwrap_err()
        };
        assert!(fault(&|rows| rows[0][0] = -1.0).contains("mirrors"));
        assert!(fault(&|rows| rows[0][1] = 0.1).contains("right angles"));
        assert!(fault(&|rows| rows[2][3] = f64::NAN).contains("not finite"));
        assert!(fault(&|rows| rows[3][0] = 0.5).contains("last row"));
        let mut rounded = pose(1.0);
        rounded[3] = [0.0, 1e-7, 2e-16, 1.0 + 1e-7];
        assert_eq!(rigid(&rounded), rigid(&pose(1.0)), "rounding is forgiven");
        assert!(rigid(&pose(0.0)).is_err() && rigid(&pose(1.0)[..2]).is_err());
    }
}
