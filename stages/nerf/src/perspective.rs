//! From world space to the unit space of a scene that is photographed from one side: what a camera
//! at its front sees, spread in depth by disparity. Knows nothing of what the field holds.

use formats::Camera;
use glam::{DMat4, DVec3, DVec4};

/// The least cosine of the angle between the mean of all cameras' axes and anything that one of
/// them sees: 66 degrees.
const LEAST_COSINE: f64 = 0.4;
/// How far cameras are taken to see, in their own near and far: readers know these from percentiles
/// of sparse points, and here a wider range costs little. Its ends were chosen by held-out PSNR
/// (fern: near alone is worth 0.2 dB).
const REACH: [f64; 2] = [0.75, 4.0];
/// Nothing seen is nearer to the front camera than this part of the nearest near: it stands as far
/// back as that takes.
const LEAST_DEPTH: f64 = 0.5;

/// A projective map, as a pinhole camera's in homogeneous coordinates (normalized device
/// coordinates; Mildenhall et al. 2020, appendix C). Straight lines stay straight, so rays are
/// marched in unit space as in a box. Equal steps are of equal disparity: as fine in depth as the
/// photos tell, and a pixel covers as many cells near as far.
#[derive(Clone, Debug, PartialEq)]
pub struct Perspective {
    /// World points to unit points, row by row; the last row is the depth before the front camera,
    /// which the others are divided by.
    pub matrix: [[f32; 4]; 4],
    inverse: DMat4,
    /// Unit lengths along the front camera's axis per disparity.
    deep: f32,
}

/// The depths along its view axis between which a camera is taken to see.
pub fn reach(camera: &Camera) -> [f64; 2] {
    [camera.near * REACH[0], camera.far * REACH[1]]
}

impl Perspective {
    /// The map of a scene that all cameras see from one side, and its extent: it holds all that
    /// they see within their [`reach`]. `None` where they do not look the same way.
    pub fn of(cameras: &[&Camera]) -> Option<(Self, [f32; 3])> {
        let rows = front(cameras)?;
        let flat = |corner: DVec3| {
            let [x, y, depth] = rows.map(|row| row.dot(corner.extend(1.0)));
            // Disparity for depth: equal steps of it are what photos tell apart.
            DVec3::new(x, y, 1.0) / depth
        };
        let corners = cameras.iter().flat_map(|camera| corners(camera)).map(flat);
        let [low, high] = corners.fold([DVec3::INFINITY, -DVec3::INFINITY], |[low, high], at| {
            [low.min(at), high.max(at)]
        });
        let size = high - low;
        // One scale for x and y, so that pixels' cells are square; depth fills 0 to 1 by itself.
        let across = 1.0 / size.x.max(size.y);
        let deep = 1.0 / size.z;
        let [x, y, depth] = rows;
        let place = [
            across * (x - low.x * depth),
            across * (y - low.y * depth),
            // The nearest, of the highest disparity, lies at 0.
            deep * (high.z * depth - DVec4::W),
        ];
        let matrix = [place[0], place[1], place[2], depth].map(|row| row.as_vec4().to_array());
        let extent = [across * size.x, across * size.y, 1.0].map(|side| side as f32);
        Some((Self::new(matrix), extent))
    }

    /// The map of a matrix; see [`Perspective::matrix`].
    pub fn new(matrix: [[f32; 4]; 4]) -> Self {
        let rows = matrix.map(|row| DVec4::from(row.map(f64::from)));
        let inverse = DMat4::from_cols(rows[0], rows[1], rows[2], rows[3])
            .transpose()
            .inverse();
        // The third row is `deep` times (a times the last less 1), whose direction is a unit
        // vector.
        let a = rows[2].truncate().dot(rows[3].truncate());
        Self {
            matrix,
            inverse,
            deep: (a * rows[3].w - rows[2].w) as f32,
        }
    }

    /// Whether every place of unit space has one in the world.
    pub fn is_whole(&self) -> bool {
        self.inverse.is_finite() && self.deep > 0.0
    }

    /// A row of the matrix times a point, whose fourth number is 1, or a direction, whose fourth
    /// number is 0.
    fn row(&self, i: usize, [x, y, z]: [f32; 3], w: f32) -> f32 {
        let [a, b, c, d] = self.matrix[i];
        a * x + b * y + c * z + d * w
    }

    /// The depth of a world point before the front camera.
    pub fn depth(&self, point: [f32; 3]) -> f32 {
        self.row(3, point, 1.0)
    }

    /// A world point in unit space; what is not before the front camera is nowhere in it.
    pub fn to_unit(&self, point: [f32; 3]) -> [f32; 3] {
        let depth = self.depth(point);
        if depth > 0.0 {
            [0, 1, 2].map(|i| self.row(i, point, 1.0) / depth)
        } else {
            // Outside of the box on every axis, whatever asks.
            [-1.0; 3]
        }
    }

    /// The gradient to a world point before the front camera, from that to where it lies in unit
    /// space.
    pub fn to_unit_backward(&self, point: [f32; 3], d_unit: [f32; 3]) -> [f32; 3] {
        let unit = self.to_unit(point);
        let depth = self.depth(point);
        std::array::from_fn(|j| {
            // The quotient rule: u = row_i p / row_3 p.
            let slope = |i: usize| self.matrix[i][j] - unit[i] * self.matrix[3][j];
            (0..3).map(|i| d_unit[i] * slope(i)).sum::<f32>() / depth
        })
    }

    /// A point of unit space in world space.
    pub fn to_world(&self, unit: [f64; 3]) -> [f64; 3] {
        self.inverse.project_point3(unit.into()).to_array()
    }

    /// Unit lengths per world length at a world point, along the front camera's axis; 0 where it is
    /// not in front.
    pub fn scale_at(&self, point: [f32; 3]) -> f32 {
        let depth = self.depth(point);
        if depth > 0.0 {
            // Disparity is 1 / depth, whose slope is 1 / depth^2.
            self.deep / (depth * depth)
        } else {
            0.0
        }
    }

    /// The part of a range of distances along a world ray in which it is behind the front face of
    /// unit space.
    pub fn behind_front(
        &self,
        origin: [f32; 3],
        direction: [f32; 3],
        [start, end]: [f32; 2],
    ) -> [f32; 2] {
        let place = self.row(2, origin, 1.0);
        let growth = self.row(2, direction, 0.0);
        match growth {
            _ if growth > 0.0 => [start.max(-place / growth), end],
            _ if growth < 0.0 => [start, end.min(-place / growth)],
            _ => [start, if place >= 0.0 { end } else { start }],
        }
    }
}

/// The front camera as rows that give right, up and depth of a world point: it looks as all do on
/// average, from among them or from as far behind as it takes for all that they see to lie before
/// it.
fn front(cameras: &[&Camera]) -> Option<[DVec4; 3]> {
    let axes = cameras
        .iter()
        .map(|camera| -camera.camera_to_world.z_axis.truncate());
    let ahead = axes.sum::<DVec3>().try_normalize()?;
    let aside = |camera: &&Camera| {
        let position = camera.position();
        // All that it sees and not its axis alone: a wide lens sees what the map cannot hold.
        corners(camera).any(|corner| (corner - position).normalize().dot(ahead) < LEAST_COSINE)
    };
    if cameras.iter().any(aside) {
        return None;
    }
    let up = cameras
        .iter()
        .map(|camera| camera.camera_to_world.y_axis.truncate())
        .sum::<DVec3>();
    // Cameras that look straight up or down have no common right, and no map.
    let right = ahead.cross(up).try_normalize()?;
    let middle = cameras
        .iter()
        .map(|camera| camera.position())
        .sum::<DVec3>()
        / cameras.len() as f64;
    let nearest = cameras
        .iter()
        .map(|camera| reach(camera)[0])
        .fold(f64::INFINITY, f64::min);
    let depths = cameras
        .iter()
        .flat_map(|camera| corners(camera))
        .map(|corner| (corner - middle).dot(ahead));
    let back = LEAST_DEPTH * nearest - depths.fold(f64::INFINITY, f64::min);
    let place = middle - ahead * back.max(0.0);
    // Each row is an axis and less the front camera's place along it.
    Some([right, right.cross(ahead), ahead].map(|axis| axis.extend(-axis.dot(place))))
}

/// The corners of what a camera sees.
fn corners(camera: &Camera) -> impl Iterator<Item = DVec3> {
    let [near, far] = reach(camera);
    Camera {
        near,
        far,
        ..*camera
    }
    .frustum_corners()
    .into_iter()
    .map(DVec3::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Side by side, a step ahead and turned a little.
    fn cameras() -> Vec<Camera> {
        let place = |x: f64, z: f64| {
            Camera::look_at(DVec3::new(x, 0.2 * x, z), DVec3::new(0.3 * x, 0.0, -4.0))
        };
        [place(-1.0, 0.0), place(0.0, -0.3), place(1.2, 0.1)]
            .map(|pose| Camera::centered((16, 12), 16.0, pose, [1.0, 9.0]))
            .into()
    }

    fn map() -> (Perspective, [f32; 3]) {
        Perspective::of(&cameras().iter().collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn unit_space_holds_what_every_camera_sees() {
        let (map, extent) = map();
        assert!(
            extent[2] == 1.0 && extent[0].max(extent[1]) == 1.0,
            "{extent:?}"
        );
        for camera in cameras() {
            for (i, depth) in [0.751, 1.0, 3.0, 35.9].into_iter().enumerate() {
                let world = camera
                    .unproject(4.0 * i as f64, 4.0 * i as f64, depth)
                    .map(|x| x as f32);
                let unit = map.to_unit(world);
                assert!(
                    (0..3).all(|a| (-1e-5..=extent[a] + 1e-5).contains(&unit[a])),
                    "{unit:?}"
                );
                let back = map.to_world(unit.map(f64::from));
                assert!(
                    (0..3).all(|a| (back[a] as f32 - world[a]).abs() < 1e-3 * depth as f32),
                    "{back:?} {world:?}"
                );
            }
        }
        assert_eq!(
            map.to_unit([0.0, 0.0, 9.0]),
            [-1.0; 3],
            "behind all cameras"
        );
    }

    #[test]
    fn lengths_along_the_axis_grow_as_the_map_says() {
        let (map, _) = map();
        let [x, y, z, _] = map.matrix[3];
        for depth in [1.0f32, 3.0, 10.0] {
            let [near, far] = [depth, depth + 1e-2].map(|d| [x * d, y * d, z * d]);
            let numeric = (map.to_unit(far)[2] - map.to_unit(near)[2]) / 1e-2;
            let middle = [x, y, z].map(|a| a * (depth + 5e-3));
            assert!(
                (numeric / map.scale_at(middle) - 1.0).abs() < 2e-2,
                "{numeric} at {depth}"
            );
        }
    }

    #[test]
    fn cameras_all_around_have_no_front() {
        let ring = [0.0f64, 2.0, 4.0].map(|angle| {
            let place = DVec3::new(3.0 * angle.sin(), 0.5, 3.0 * angle.cos());
            Camera::centered((8, 8), 8.0, Camera::look_at(place, DVec3::ZERO), [1.0, 5.0])
        });
        assert!(Perspective::of(&ring.iter().collect::<Vec<_>>()).is_none());
    }
}
