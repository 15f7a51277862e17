//! A splat as a camera sees it: an ellipse in the image (elliptical weighted averages, Zwicker et
//! al. 2001), forward and back to the splat's size. Knows no pixels.

use formats::Camera;
use glam::{Mat3, Vec2, Vec3};

use crate::cloud::Splat;
use crate::harmonics::{self, MOST};

/// What viewers of splats add to both variances, in pixels²: a pixel is no point.
const PIXEL: f32 = 0.3;
/// What adds less to a pixel is not drawn. Derivatives know nothing of that edge, so tests of them
/// have it where it does not show.
pub const FAINTEST: f32 = if cfg!(test) { 1e-6 } else { 1.0 / 255.0 };
/// Nothing is more opaque than this, so that what lies behind keeps a gradient.
pub const DENSEST: f32 = 0.99;
/// Beyond this part of the image's half width the slope of the projection is taken at its rim: far
/// aside a Gaussian's image is none.
const RIM: f32 = 1.3;

/// A symmetric 2x2 matrix: xx, xy, yy.
pub type Symmetric = [f32; 3];

/// A camera as splats need it: right, down, forwards.
pub struct Eye {
    position: Vec3,
    /// From world directions to the camera's.
    turn: Mat3,
    focal: Vec2,
    center: Vec2,
    rim: Vec2,
    near: f32,
}

/// A splat in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Its middle, in pixels.
    pub center: Vec2,
    /// The inverse of its covariance.
    pub conic: Symmetric,
    /// Half the sides of the box outside of which it is too faint.
    pub reach: Vec2,
    /// Its opacity in the middle.
    pub opacity: f32,
    /// Its colour towards the camera.
    pub color: [f32; 3],
    /// Depth along the view axis.
    pub depth: f32,
}

/// The derivative of a loss by what is drawn of a splat.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ByEllipse {
    pub conic: Symmetric,
    pub opacity: f32,
    pub color: [f32; 3],
}

/// The derivative of a loss by what is fitted of a splat.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BySplat {
    pub log_scale: Vec3,
    pub logit: f32,
    pub harmonics: [[f32; 3]; MOST],
}

impl Eye {
    /// A pinhole's; a lens is passed over.
    pub fn new(camera: &Camera) -> Self {
        let pose = camera.camera_to_world;
        let axis = |axis: glam::DVec4| axis.truncate().as_vec3();
        // From OpenGL's up and backwards to down and forwards.
        let to_world = Mat3::from_cols(axis(pose.x_axis), -axis(pose.y_axis), -axis(pose.z_axis));
        let focal = Vec2::new(camera.fl_x as f32, camera.fl_y as f32);
        let size = Vec2::new(camera.width as f32, camera.height as f32);
        Self {
            position: camera.position().as_vec3(),
            turn: to_world.transpose(),
            focal,
            center: Vec2::new(camera.cx as f32, camera.cy as f32),
            rim: RIM * 0.5 * size / focal,
            near: camera.near as f32,
        }
    }

    /// The values of the harmonics towards a splat.
    fn harmonics(&self, splat: &Splat) -> [f32; MOST] {
        harmonics::values((splat.position - self.position).normalize_or(Vec3::Z))
    }

    /// A splat's axes in the image, in pixels for a standard deviation of 1; and its middle in the
    /// camera.
    fn axes(&self, splat: &Splat) -> ([Vec2; 3], Vec3) {
        let middle = self.turn * (splat.position - self.position);
        let z = middle.z;
        // Far aside the linear slope no longer fits, and would draw a splat over the whole image.
        let aside = (middle.truncate() / z).clamp(-self.rim, self.rim);
        let image = |axis: Vec3| {
            let axis = self.turn * axis;
            // The slope of the projection: d(x / z) = (dx - (x / z) dz) / z.
            self.focal * (axis.truncate() - aside * axis.z) / z
        };
        (splat.axes().map(image), middle)
    }

    /// The splat in the image; `None` if it is too near, too faint or degenerate.
    pub fn project(&self, splat: &Splat, coefficients: usize) -> Option<Ellipse> {
        let opacity = splat.opacity();
        let middle = self.turn * (splat.position - self.position);
        // Half of near: what stands at it keeps its image.
        if middle.z < 0.5 * self.near || opacity <= FAINTEST {
            return None;
        }
        let (axes, middle) = self.axes(splat);
        let covariance = covariance(&axes, splat.scale());
        let conic = inverse(covariance)?;
        let [xx, _, yy] = covariance;
        // Where opacity exp(-d^2 / 2) falls to FAINTEST.
        let deviations = (2.0 * (opacity / FAINTEST).ln()).sqrt();
        Some(Ellipse {
            center: self.center + self.focal * middle.truncate() / middle.z,
            conic,
            reach: deviations * Vec2::new(xx.sqrt(), yy.sqrt()),
            opacity,
            color: harmonics::color(&splat.harmonics[..coefficients], &self.harmonics(splat)),
            depth: middle.z,
        })
    }

    /// The derivative by the splat from that by its image.
    pub fn project_backward(&self, splat: &Splat, coefficients: usize, by: &ByEllipse) -> BySplat {
        let mut by_splat = BySplat::default();
        let (axes, _) = self.axes(splat);
        let scale = splat.scale();
        let Some(conic) = inverse(covariance(&axes, scale)) else {
            return by_splat;
        };
        // The middle has no derivative: places are the field's and stay.
        let by_covariance = inverse_backward(conic, by.conic);
        for axis in 0..3 {
            // The covariance is the sum of s² u uᵀ over axes.
            let variance = scale[axis] * scale[axis];
            by_splat.log_scale[axis] = 2.0 * variance * form(by_covariance, axes[axis]);
        }
        let opacity = splat.opacity();
        // The slope of the logistic function, from its value.
        by_splat.logit = by.opacity * opacity * (1.0 - opacity);
        harmonics::color_backward(
            &splat.harmonics[..coefficients],
            &self.harmonics(splat),
            by.color,
            &mut by_splat.harmonics[..coefficients],
        );
        by_splat
    }
}

fn covariance(axes: &[Vec2; 3], scale: Vec3) -> Symmetric {
    // Both variances begin with a pixel's, which also keeps the determinant above 0.
    let mut sum = [PIXEL, 0.0, PIXEL];
    for (axis, scale) in axes.iter().zip(scale.to_array()) {
        let u = *axis * scale;
        sum[0] += u.x * u.x;
        sum[1] += u.x * u.y;
        sum[2] += u.y * u.y;
    }
    sum
}

fn inverse([xx, xy, yy]: Symmetric) -> Option<Symmetric> {
    let determinant = xx * yy - xy * xy;
    (determinant > 0.0 && determinant.is_finite())
        .then(|| [yy / determinant, -xy / determinant, xx / determinant])
}

/// The derivative by a matrix from that by its inverse: -C G C. Off the diagonal both hold what
/// each of the two equal numbers has.
fn inverse_backward(conic: Symmetric, by: Symmetric) -> Symmetric {
    let [a, b, c] = conic;
    let [p, q, r] = by;
    let left = [
        [a * p + b * q, a * q + b * r],
        [b * p + c * q, b * q + c * r],
    ];
    [
        -(left[0][0] * a + left[0][1] * b),
        -(left[0][0] * b + left[0][1] * c),
        -(left[1][0] * b + left[1][1] * c),
    ]
}

/// The quadratic form uᵀ G u.
fn form([xx, xy, yy]: Symmetric, u: Vec2) -> f32 {
    xx * u.x * u.x + 2.0 * xy * u.x * u.y + yy * u.y * u.y
}
