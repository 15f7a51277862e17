//! The fisheye model of Kannala and Brandt as OpenCV has it: angles from the optical axis, bent by
//! a polynomial. Knows no pixels and no poses.

/// Rays farther from the optical axis than this many radians (80 degrees) are not followed: a scene
/// with depths along the axis cannot hold them.
const WIDEST: f64 = 1.4;
/// Newton's method needs four steps or so.
const STEPS: usize = 40;
const TOLERANCE: f64 = 1e-14;

/// k1 to k4: an angle t is seen at t (1 + k1 t² + k2 t⁴ + k3 t⁶ + k4 t⁸) focal lengths from the
/// middle.
pub(super) struct Fisheye(pub(super) [f64; 4]);

impl Fisheye {
    /// Where a point of the image plane at depth 1 is seen.
    pub(super) fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let radius = x.hypot(y);
        // Straight ahead r is 0, and the quotient below is 0 / 0.
        if radius == 0.0 {
            return [x, y];
        }
        let part = self.bent(radius.atan()).0 / radius;
        [part * x, part * y]
    }

    /// The inverse of [`Fisheye::apply`]; `None` past the rim.
    pub(super) fn undo(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let seen = x.hypot(y);
        if seen == 0.0 {
            return Some([x, y]);
        }
        let angle = self.angle(seen)?;
        let part = angle.tan() / seen;
        Some([part * x, part * y])
    }

    /// Whether the point lies before the rim: up to it a larger angle is seen farther out.
    pub(super) fn is_before_fold(&self, [x, y]: [f64; 2]) -> bool {
        let angle = x.hypot(y).atan();
        angle <= WIDEST && self.grows_up_to(angle)
    }

    fn angle(&self, seen: f64) -> Option<f64> {
        // Without coefficients a fisheye's radius is the angle itself.
        let mut angle = seen.min(WIDEST);
        for _ in 0..STEPS {
            let (at, slope) = self.bent(angle);
            // Past the fold a larger angle is seen further in.
            if slope.is_nan() || slope <= 0.0 {
                return None;
            }
            if (at - seen).abs() <= TOLERANCE * (1.0 + seen) {
                // A root beyond the rim is one of the polynomial only, not of the lens.
                return (angle <= WIDEST && self.grows_up_to(angle)).then_some(angle);
            }
            // Below 0 it would come up on the other side of the axis.
            angle = (angle - (at - seen) / slope).max(0.0);
        }
        None
    }

    fn grows_up_to(&self, angle: f64) -> bool {
        const PROBES: u32 = 32;
        // At a few angles on the way, since the polynomial may fall and rise again before this one.
        (1..=PROBES).all(|i| self.bent(angle * f64::from(i) / f64::from(PROBES)).1 > 0.0)
    }

    /// Where an angle is seen, and the derivative.
    fn bent(&self, angle: f64) -> (f64, f64) {
        let [k1, k2, k3, k4] = self.0;
        // Horner's form: few operations, and no large powers.
        let t2 = angle * angle;
        let factor = 1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)));
        let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
        (angle * factor, slope)
    }
}
