//! A camera: where it stands, what it sees, and the rays of its pixels. Knows nothing of images or files.

use glam::{DMat4, DVec3, DVec4};

use crate::Distortion;

/// Points along each side of the image that [`Camera::view_window`] looks through.
const RIM: u32 = 32;

/// A pinhole camera, perhaps behind a lens that bends.
///
/// Axes are OpenGL's: in camera space +x is right, +y up, and the camera looks along -z. In images y points down and
/// the centre of pixel (0, 0) lies at (0.5, 0.5), so an image spans `0..width` by `0..height`.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length in pixel widths.
    pub fl_x: f64,
    /// Focal length in pixel heights.
    pub fl_y: f64,
    /// Where the optical axis meets the image, in pixels from its left edge.
    pub cx: f64,
    /// Where the optical axis meets the image, in pixels from its top edge.
    pub cy: f64,
    /// How the lens bends what a pinhole would see.
    pub distortion: Distortion,
    /// Rigid transform from camera space to world space, acting on column vectors.
    pub camera_to_world: DMat4,
    /// Depth along the view axis, in world units, before which there is nothing to see.
    pub near: f64,
    /// Depth along the view axis, in world units, behind which there is nothing to see.
    pub far: f64,
}

/// A half-line through a point of the image plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The camera's position in world space.
    pub origin: [f32; 3],
    /// Unit vector in world space.
    pub direction: [f32; 3],
    /// Distance along this ray per unit of depth along the view axis (1 in the image's middle, more towards its rim):
    /// the ray meets the near plane at distance `near * distance_per_depth`.
    pub distance_per_depth: f32,
}

impl Camera {
    /// The ray through the image point (`px`, `py`), in pixels; `(x + 0.5, y + 0.5)` is the centre of pixel (x, y). The
    /// lens is undone: the ray goes to what is really seen there.
    pub fn ray(&self, px: f64, py: f64) -> Ray {
        let in_camera = self.at_unit_depth(px, py);
        let length = in_camera.length();
        let direction = self.camera_to_world.transform_vector3(in_camera / length);
        Ray {
            origin: self.position().as_vec3().to_array(),
            direction: direction.as_vec3().to_array(),
            distance_per_depth: length as f32,
        }
    }

    /// Where a world point appears: (px, py, depth along the view axis). The inverse of [`Camera::ray`].
    /// `None` if the point is not in front of the camera, or so far aside that no ray through this lens meets it. The
    /// image's borders do not clip.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 3]> {
        let p = self.camera_to_world.inverse().transform_point3(point.into());
        let depth = -p.z;
        if depth <= 0.0 {
            return None;
        }
        let [x, y] = self.bend([p.x / depth, -p.y / depth])?;
        Some([self.cx + self.fl_x * x, self.cy + self.fl_y * y, depth])
    }

    /// The world point seen at (`px`, `py`) at a depth along the view axis.
    pub fn unproject(&self, px: f64, py: f64, depth: f64) -> [f64; 3] {
        self.camera_to_world.transform_point3(self.at_unit_depth(px, py) * depth).to_array()
    }

    /// The same camera with another number of pixels on the same image plane. Each axis is scaled on its own, so that
    /// sizes that do not divide still show exactly the same part of the world.
    pub fn scaled(&self, width: u32, height: u32) -> Camera {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Camera {
            width,
            height,
            fl_x: self.fl_x * sx,
            fl_y: self.fl_y * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..self.clone()
        }
    }

    /// The camera's position in world space.
    pub fn position(&self) -> DVec3 {
        self.camera_to_world.w_axis.truncate()
    }

    /// What the camera sees of the plane at depth 1: `[left, right, low, high]` in camera space (x right, y up). With a lens
    /// that bends, the smallest such window around all that is seen.
    pub fn view_window(&self) -> [f64; 4] {
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let steps = if self.distortion.is_none() { 1 } else { RIM };
        let along = (0..=steps).map(|step| f64::from(step) / f64::from(steps));
        let rim = along.flat_map(|t| [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)]);
        rim.map(|(px, py)| self.at_unit_depth(px, py)).fold(
            [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY],
            |[left, right, low, high], p| [left.min(p.x), right.max(p.x), low.min(p.y), high.max(p.y)],
        )
    }

    /// Eight world-space corners around what the camera sees between `near` and `far`.
    pub fn frustum_corners(&self) -> [[f64; 3]; 8] {
        let [left, right, low, high] = self.view_window();
        let rim = [(left, high), (right, high), (left, low), (right, low)];
        std::array::from_fn(|i| {
            let (x, y) = rim[i % 4];
            let depth = if i < 4 { self.near } else { self.far };
            self.camera_to_world.transform_point3(DVec3::new(x, y, -1.0) * depth).to_array()
        })
    }

    /// Whether there is a ray for every part of the image: a lens whose numbers are wrong may fold its rim over.
    pub fn sees_through_all_its_image(&self) -> bool {
        let at = |i: u32| f64::from(i) / f64::from(RIM);
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let seen = |i, j| [(at(i) * w - self.cx) / self.fl_x, (at(j) * h - self.cy) / self.fl_y];
        let has_ray =
            |i, j| self.distortion.undo(seen(i, j)).is_some_and(|point| self.distortion.is_before_fold(point));
        (0..=RIM).all(|j| (0..=RIM).all(|i| has_ray(i, j)))
    }

    /// A camera pose at `position` that looks at `target` with world +y up.
    pub fn look_at(position: DVec3, target: DVec3) -> DMat4 {
        Camera::look_at_with_up(position, target, DVec3::Y)
    }

    /// The same with another direction upwards in the image.
    pub fn look_at_with_up(position: DVec3, target: DVec3, up: DVec3) -> DMat4 {
        let back = (position - target).normalize();
        let right = up.cross(back).normalize();
        let up = back.cross(right);
        DMat4::from_cols(right.extend(0.0), up.extend(0.0), back.extend(0.0), position.extend(1.0))
    }

    /// The same camera after a similarity of the world: first the rigid motion `rigid`, then a uniform `scale` about the
    /// origin. What it sees stays where it was in the image; depths, near and far are scaled.
    pub(crate) fn moved(&self, rigid: DMat4, scale: f64) -> Camera {
        let mut camera_to_world = rigid * self.camera_to_world;
        camera_to_world.w_axis = DVec4::from((camera_to_world.w_axis.truncate() * scale, 1.0));
        Camera { camera_to_world, near: self.near * scale, far: self.far * scale, ..self.clone() }
    }

    fn at_unit_depth(&self, px: f64, py: f64) -> DVec3 {
        let seen = [(px - self.cx) / self.fl_x, (py - self.cy) / self.fl_y];
        // Readers refuse cameras without a ray for every pixel; past the rim the pinhole's ray is as good as any.
        let [x, y] = self.distortion.undo(seen).unwrap_or(seen);
        DVec3::new(x, -y, -1.0)
    }

    /// Where a point of the image plane (y down) is seen through the lens; `None` beyond the rim where it folds over.
    fn bend(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        self.distortion.is_before_fold(point).then(|| self.distortion.apply(point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    const NONE: Distortion = Distortion { k1: 0.0, k2: 0.0, k3: 0.0, p1: 0.0, p2: 0.0 };

    /// None, or one as phones have it.
    fn any_lens() -> impl Strategy<Value = Distortion> {
        let bent = (-0.06..0.06f64, -0.02..0.02f64, -0.005..0.005f64, -0.005..0.005f64);
        prop_oneof![Just(NONE), bent.prop_map(|(k1, k2, p1, p2)| Distortion { k1, k2, k3: 0.0, p1, p2 })]
    }

    fn any_camera() -> impl Strategy<Value = Camera> {
        let pose = (prop::array::uniform3(-9.0..9.0f64), prop::array::uniform3(-3.0..3.0f64));
        (pose, 40..900u32, 40..900u32, 50.0..2000.0f64, 50.0..2000.0f64, 0.2..0.8f64, any_lens()).prop_map(
            |((position, turn), width, height, fl_x, fl_y, middle, distortion)| Camera {
                distortion: if f64::from(width).max(height.into()) < 1.5 * fl_x.min(fl_y) { distortion } else { NONE },
                width,
                height,
                fl_x,
                fl_y,
                cx: f64::from(width) * middle,
                cy: f64::from(height) * (1.0 - middle),
                camera_to_world: DMat4::from_rotation_translation(
                    DQuat::from_scaled_axis(turn.into()),
                    position.into(),
                ),
                near: 1.0,
                far: 5.0,
            },
        )
    }

    fn along(ray: &Ray, depth: f64) -> [f64; 3] {
        let distance = depth * f64::from(ray.distance_per_depth);
        std::array::from_fn(|i| f64::from(ray.origin[i]) + distance * f64::from(ray.direction[i]))
    }

    proptest! {
        #[test]
        fn project_inverts_ray(camera in any_camera(), u in 0.0..1.0f64, v in 0.0..1.0f64, depth in 0.1..50.0f64) {
            let (px, py) = (u * f64::from(camera.width), v * f64::from(camera.height));
            let ray = camera.ray(px, py);
            let seen = camera.project(along(&ray, depth)).unwrap();
            // Rays are f32: their rounding, about 1e-6 of the distance, shows as so many focal lengths of pixels.
            let tolerance = 1e-5 * f64::from(ray.distance_per_depth) * (1.0 + 10.0 / depth);
            prop_assert!((seen[0] - px).abs() < tolerance * camera.fl_x, "{seen:?} for {px} {py}");
            prop_assert!((seen[1] - py).abs() < tolerance * camera.fl_y, "{seen:?} for {px} {py}");
            prop_assert!((seen[2] - depth).abs() < tolerance * depth);
        }

        #[test]
        fn project_inverts_unproject(camera in any_camera(), u in 0.0..1.0f64, v in 0.0..1.0f64, depth in 0.1..50.0f64) {
            let (px, py) = (u * f64::from(camera.width), v * f64::from(camera.height));
            let seen = camera.project(camera.unproject(px, py, depth)).unwrap();
            for (got, want) in seen.into_iter().zip([px, py, depth]) {
                prop_assert!((got - want).abs() < 1e-8 * (1.0 + want.abs()), "{seen:?}");
            }
        }

        #[test]
        fn scaling_keeps_the_image_plane(camera in any_camera(), w in 1..400u32, h in 1..400u32, u in 0.0..1.0f64, v in 0.0..1.0f64) {
            let scaled = camera.scaled(w, h);
            let a = camera.unproject(u * f64::from(camera.width), v * f64::from(camera.height), 2.0);
            let b = scaled.unproject(u * f64::from(w), v * f64::from(h), 2.0);
            for i in 0..3 {
                prop_assert!((a[i] - b[i]).abs() < 1e-9 * (1.0 + a[i].abs()), "{a:?} {b:?}");
            }
        }
    }

    fn front_camera() -> Camera {
        Camera {
            width: 8,
            height: 6,
            fl_x: 4.0,
            fl_y: 4.0,
            cx: 4.0,
            cy: 3.0,
            distortion: NONE,
            camera_to_world: DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)),
            near: 1.0,
            far: 4.0,
        }
    }

    #[test]
    fn an_unturned_camera_looks_along_minus_z_with_y_up() {
        let camera = front_camera();
        assert_eq!(camera.ray(4.0, 3.0).direction, [0.0, 0.0, -1.0]);
        assert_eq!(camera.ray(4.0, 3.0).distance_per_depth, 1.0);
        let top_left = camera.ray(0.5, 0.5).direction;
        assert!(top_left[0] < 0.0 && top_left[1] > 0.0, "{top_left:?}");
        assert_eq!(camera.unproject(0.0, 0.0, 4.0), [-3.0, 5.0, -1.0]);
        assert_eq!(camera.project([1.0, 2.0, 3.5]), None, "behind the camera");
    }

    #[test]
    fn look_at_puts_the_target_in_the_middle_and_up_upwards() {
        let (position, target) = (DVec3::new(2.0, 1.5, 3.0), DVec3::new(0.0, 0.5, -0.2));
        let camera = Camera { camera_to_world: Camera::look_at(position, target), ..front_camera() };
        let seen = camera.project(target.to_array()).unwrap();
        assert!((seen[0] - 4.0).abs() < 1e-9 && (seen[1] - 3.0).abs() < 1e-9, "{seen:?}");
        assert!((seen[2] - position.distance(target)).abs() < 1e-9);
        assert!(camera.project((target + DVec3::Y).to_array()).unwrap()[1] < 3.0, "up is towards row 0");
    }

    #[test]
    fn a_bent_lens_widens_the_window_to_all_that_is_seen() {
        let barrel = |k1| Camera { distortion: Distortion { k1, ..NONE }, ..front_camera() };
        let (straight, bent) = (front_camera().view_window(), barrel(-0.05).view_window());
        assert_eq!(straight, [-1.0, 1.0, -0.75, 0.75]);
        assert!(bent[0] < straight[0] && bent[3] > straight[3], "{bent:?}");
        assert!(barrel(-0.05).sees_through_all_its_image());
        assert!(!barrel(-0.2).sees_through_all_its_image(), "its corners, 1.25 focal lengths off, lie past the fold");
        let pincushion = Camera { distortion: Distortion { k1: 0.2, ..NONE }, ..front_camera() };
        assert!(pincushion.sees_through_all_its_image());
        let window = pincushion.view_window();
        for i in 0..=100 {
            let p = pincushion.at_unit_depth(8.0 * f64::from(i) / 100.0, 0.0);
            assert!(p.x > window[0] - 1e-3 && p.x < window[1] + 1e-3 && p.y < window[3] + 1e-3, "{p}");
        }
        assert_eq!(barrel(-0.05).project([1.0 + 40.0, 2.0, 2.0]), None, "no ray goes so far aside");
    }

    #[test]
    fn frustum_corners_lie_on_the_near_and_far_planes() {
        let camera = front_camera();
        let depths: Vec<f64> = camera.frustum_corners().map(|p| camera.project(p).unwrap()[2]).to_vec();
        assert_eq!(depths, [1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0]);
    }
}
