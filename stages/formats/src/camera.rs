//! A camera: where it stands, what it sees, and the rays of its pixels. Its serde form is that of
//! our files. Knows nothing of images.

mod check;

use glam::{DMat4, DVec3, DVec4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Distortion;

pub use check::CameraError;

/// Points along each side of the image that [`Camera::view_window`] looks through.
const RIM: u32 = 32;

/// A pinhole camera, perhaps behind a lens that bends.
///
/// Axes are OpenGL's: in camera space +x is right, +y up, and the camera looks along -z. In images
/// y points down and the centre of pixel (0, 0) lies at (0.5, 0.5), so an image spans `0..width` by
/// `0..height`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    #[serde(default, skip_serializing_if = "Distortion::is_none")]
    pub distortion: Distortion,
    /// Rigid transform from camera space to world space, acting on column vectors; in files its
    /// rows.
    #[serde(with = "crate::rows")]
    #[schemars(with = "[[f64; 4]; 4]")]
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
    /// Distance along this ray per unit of depth along the view axis (1 in the image's middle, more
    /// towards its rim): the ray meets the near plane at distance `near * distance_per_depth`.
    pub distance_per_depth: f32,
}

impl Camera {
    /// A camera with square pixels, its axis through the image's middle and no lens; `range` is
    /// near and far.
    pub fn centered(
        (width, height): (u32, u32),
        focal: f64,
        camera_to_world: DMat4,
        [near, far]: [f64; 2],
    ) -> Self {
        Camera {
            width,
            height,
            fl_x: focal,
            fl_y: focal,
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
            distortion: Distortion::default(),
            camera_to_world,
            near,
            far,
        }
    }

    /// The ray through the image point (`px`, `py`), in pixels; `(x + 0.5, y + 0.5)` is the centre
    /// of pixel (x, y). The lens is undone: the ray goes to what is really seen there.
    pub fn ray(&self, px: f64, py: f64) -> Ray {
        let in_camera = self.at_unit_depth(px, py);
        let length = in_camera.length();
        // All in f64; numbers are rounded to single precision only once, below.
        let direction = self.camera_to_world.transform_vector3(in_camera / length);
        Ray {
            origin: self.position().as_vec3().to_array(),
            direction: direction.as_vec3().to_array(),
            distance_per_depth: length as f32,
        }
    }

    /// Where a world point appears: (px, py, depth along the view axis). The inverse of
    /// [`Camera::ray`]. `None` if the point is not in front of the camera, or so far aside that no
    /// ray through this lens meets it. The image's borders do not clip.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 3]> {
        let p = self
            .camera_to_world
            .inverse()
            .transform_point3(point.into());
        let depth = -p.z;
        // Behind the camera the division would mirror the point into the image.
        if depth <= 0.0 {
            return None;
        }
        // Rows of an image go down.
        let [x, y] = self.bend([p.x / depth, -p.y / depth])?;
        Some([self.cx + self.fl_x * x, self.cy + self.fl_y * y, depth])
    }

    /// The world point seen at (`px`, `py`) at a depth along the view axis.
    pub fn unproject(&self, px: f64, py: f64, depth: f64) -> [f64; 3] {
        self.camera_to_world
            .transform_point3(self.at_unit_depth(px, py) * depth)
            .to_array()
    }

    /// This camera with another number of pixels on its image plane. Each axis is scaled on its
    /// own, so that sizes that do not divide still show exactly the same part of the world.
    pub fn scaled(&self, width: u32, height: u32) -> Camera {
        // Not one factor for both: 252x189 by 4 is 63x47, whose pixels are not square.
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Camera {
            width,
            height,
            fl_x: self.fl_x * sx,
            fl_y: self.fl_y * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..*self
        }
    }

    /// This camera with `scale` times the pixels along each axis, rounded to whole ones.
    pub fn scaled_by(&self, scale: f64) -> Camera {
        // At least one: a picture without pixels is none.
        let pixels = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
        self.scaled(pixels(self.width), pixels(self.height))
    }

    /// The camera's position in world space.
    pub fn position(&self) -> DVec3 {
        self.camera_to_world.w_axis.truncate()
    }

    /// What the camera sees of the plane at depth 1: `[left, right, low, high]` in camera space (x
    /// right, y up). With a lens that bends, the smallest such window around all that is seen.
    pub fn view_window(&self) -> [f64; 4] {
        let w = f64::from(self.width);
        let h = f64::from(self.height);
        // A straight lens sees furthest at its corners; of a bent one that may be anywhere on the
        // rim.
        let steps = if self.distortion.is_none() { 1 } else { RIM };
        let along = (0..=steps).map(|step| f64::from(step) / f64::from(steps));
        let rim = along.flat_map(|t| [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)]);
        rim.map(|(px, py)| self.at_unit_depth(px, py)).fold(
            [
                f64::INFINITY,
                f64::NEG_INFINITY,
                f64::INFINITY,
                f64::NEG_INFINITY,
            ],
            |[left, right, low, high], p| {
                [left.min(p.x), right.max(p.x), low.min(p.y), high.max(p.y)]
            },
        )
    }

    /// Eight world-space corners around what the camera sees between `near` and `far`.
    pub fn frustum_corners(&self) -> [[f64; 3]; 8] {
        let [left, right, low, high] = self.view_window();
        let rim = [(left, high), (right, high), (left, low), (right, low)];
        std::array::from_fn(|i| {
            let (x, y) = rim[i % 4];
            let depth = if i < 4 { self.near } else { self.far };
            self.camera_to_world
                .transform_point3(DVec3::new(x, y, -1.0) * depth)
                .to_array()
        })
    }

    /// Whether there is a ray for every part of the image: a lens whose numbers are wrong may fold
    /// its rim over. A fisheye's corners may lie beyond its rim; of it only half must have rays.
    pub fn sees_through_its_image(&self) -> bool {
        let at = |i: u32, side: u32| f64::from(i) / f64::from(RIM) * f64::from(side);
        let points = (0..=RIM).flat_map(|j| (0..=RIM).map(move |i| (i, j)));
        let without = points
            .filter(|(i, j)| !self.has_ray(at(*i, self.width), at(*j, self.height)))
            .count() as u32;
        // A fisheye's image is round: its corners have no rays.
        let most = if self.distortion.fisheye {
            (RIM + 1) * (RIM + 1) / 2
        } else {
            0
        };
        without <= most
    }

    /// Whether there is a ray through a point of the image, in pixels.
    pub fn has_ray(&self, px: f64, py: f64) -> bool {
        // Newton's method may end beyond the fold, where the formula holds and no lens does.
        let undone = self.distortion.undo(self.seen(px, py));
        undone.is_some_and(|point| self.distortion.is_before_fold(point))
    }

    /// A camera pose at `position` that looks at `target` with world +y up.
    pub fn look_at(position: DVec3, target: DVec3) -> DMat4 {
        Camera::look_at_with_up(position, target, DVec3::Y)
    }

    /// A camera pose at `position` that looks at `target`, with `up` upwards in the image.
    pub fn look_at_with_up(position: DVec3, target: DVec3, up: DVec3) -> DMat4 {
        let back = (position - target).normalize();
        let right = up.cross(back).normalize();
        // Taken anew: the direction asked for need not be at right angles to the view.
        let up = back.cross(right);
        DMat4::from_cols(
            right.extend(0.0),
            up.extend(0.0),
            back.extend(0.0),
            position.extend(1.0),
        )
    }

    /// This camera after a similarity of the world: first the rigid motion `rigid`, then a uniform
    /// `scale` about the origin. What it sees stays where it was in the image; depths, near and far
    /// are scaled.
    pub fn moved(&self, rigid: DMat4, scale: f64) -> Camera {
        let mut camera_to_world = rigid * self.camera_to_world;
        // Only places are scaled; axes stay of unit length.
        camera_to_world.w_axis = DVec4::from((camera_to_world.w_axis.truncate() * scale, 1.0));
        Camera {
            camera_to_world,
            near: self.near * scale,
            far: self.far * scale,
            ..*self
        }
    }

    fn at_unit_depth(&self, px: f64, py: f64) -> DVec3 {
        let seen = self.seen(px, py);
        // Readers refuse or mask pixels without a ray; past the rim the pinhole's ray is as good as
        // any.
        let [x, y] = self.distortion.undo(seen).unwrap_or(seen);
        DVec3::new(x, -y, -1.0)
    }

    /// A point of the image in focal lengths from the optical axis.
    fn seen(&self, px: f64, py: f64) -> [f64; 2] {
        [(px - self.cx) / self.fl_x, (py - self.cy) / self.fl_y]
    }

    /// Where a point of the image plane (y down) is seen through the lens; `None` beyond the rim
    /// where it folds over.
    fn bend(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        self.distortion
            .is_before_fold(point)
            .then(|| self.distortion.apply(point))
    }
}

#[cfg(test)]
mod tests;
