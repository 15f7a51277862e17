//! Lens distortion as OpenCV models it: where a straight line bends to, and back. Knows no pixels
//! and no poses.

mod fisheye;

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use fisheye::Fisheye;

/// How near to the exact answer [`Distortion::undo`] comes, in focal lengths: less than a billionth
/// of a pixel.
const TOLERANCE: f64 = 1e-13;
/// Newton's method needs four steps or so; where the model folds over it may never end.
const STEPS: usize = 40;

/// Radial (k1 to k6) and tangential (p1, p2) distortion as OpenCV's pinhole models have it, or a
/// fisheye (k1 to k4) as its fisheye model has it. All zero, the default, is a pinhole.
///
/// Points are those of OpenCV's image plane at depth 1, in focal lengths from the optical axis: x
/// right, y *down*. With r² = x² + y² and
/// f = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) the point (x, y) is seen at
/// (x f + 2 p1 x y + p2 (r² + 2 x²), y f + p1 (r² + 2 y²) + 2 p2 x y). A fisheye sees it at
/// (x, y) t' / r, where t = atan(r) and t' = t (1 + k1 t² + k2 t⁴ + k3 t⁶ + k4 t⁸).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Distortion {
    /// Coefficient of r², or of the angle's square.
    pub k1: f64,
    /// Coefficient of r⁴, or of the angle's fourth power.
    pub k2: f64,
    /// Coefficient of r⁶, or of the angle's sixth power.
    pub k3: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Coefficient of r² below the line, or of the angle's eighth power.
    #[serde(skip_serializing_if = "is_zero")]
    pub k4: f64,
    /// Coefficient of r⁴ below the line.
    #[serde(skip_serializing_if = "is_zero")]
    pub k5: f64,
    /// Coefficient of r⁶ below the line.
    #[serde(skip_serializing_if = "is_zero")]
    pub k6: f64,
    /// Whether it is a fisheye.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub fisheye: bool,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// A point of the image plane at depth 1: x right, y down.
type Point = [f64; 2];

impl Distortion {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// A fisheye of these k1 to k4.
    pub fn fisheye([k1, k2, k3, k4]: [f64; 4]) -> Self {
        Self {
            k1,
            k2,
            k3,
            k4,
            fisheye: true,
            ..Self::default()
        }
    }

    /// k1 to k6, p1 and p2.
    pub fn coefficients(&self) -> [f64; 8] {
        let Self { k1, k2, k3, .. } = *self;
        let Self { k4, k5, k6, .. } = *self;
        [k1, k2, k3, k4, k5, k6, self.p1, self.p2]
    }

    /// Where the point is seen through the lens.
    pub fn apply(&self, point: Point) -> Point {
        match self.as_fisheye() {
            Some(fisheye) => fisheye.apply(point),
            None => self.with_slope(point).0,
        }
    }

    /// The point that is seen here: the inverse of [`Distortion::apply`] around the optical axis.
    ///
    /// `None` where there is no such point: beyond the rim at which a strong distortion folds the
    /// image over.
    pub fn undo(&self, seen: Point) -> Option<Point> {
        // Pinholes, the common case, come back to the last bit.
        if self.is_none() {
            return Some(seen);
        }
        if let Some(fisheye) = self.as_fisheye() {
            return fisheye.undo(seen);
        }
        // Starts at what is seen: near the axis a lens moves points little.
        let mut point = seen;
        for _ in 0..STEPS {
            let (at, [[a, b], [c, d]]) = self.with_slope(point);
            let off = [at[0] - seen[0], at[1] - seen[1]];
            let determinant = a * d - b * c;
            // From the axis outwards the determinant falls from 1; past 0 the image runs backwards.
            if determinant.is_nan() || determinant <= 0.0 {
                return None;
            }
            if off[0].hypot(off[1]) <= TOLERANCE * (1.0 + seen[0].hypot(seen[1])) {
                return Some(point);
            }
            // Newton's step: the inverse of the slope times what is off.
            point[0] -= (d * off[0] - b * off[1]) / determinant;
            point[1] -= (a * off[1] - c * off[0]) / determinant;
        }
        None
    }

    /// Whether the point lies before the rim at which a strong distortion folds the image over:
    /// from the axis to it, the image keeps its sense.
    pub fn is_before_fold(&self, [x, y]: Point) -> bool {
        const PROBES: u32 = 32;
        if let Some(fisheye) = self.as_fisheye() {
            return fisheye.is_before_fold([x, y]);
        }
        self.is_none()
            || (1..=PROBES)
                .map(|i| f64::from(i) / f64::from(PROBES))
                .all(|part| {
                    let (_, [[a, b], [c, d]]) = self.with_slope([part * x, part * y]);
                    // The slope is symmetric: determinant and trace above 0 are both eigenvalues
                    // above 0.
                    a * d - b * c > 0.0 && a + d > 0.0
                })
    }

    fn as_fisheye(&self) -> Option<Fisheye> {
        let Self { k1, k2, k3, k4, .. } = *self;
        self.fisheye.then_some(Fisheye([k1, k2, k3, k4]))
    }

    /// Where the point is seen through a lens that is no fisheye, and the derivative: rows by what
    /// is seen, columns by the point.
    fn with_slope(&self, [x, y]: Point) -> (Point, [[f64; 2]; 2]) {
        let Self { k1, k2, k3, .. } = *self;
        let Self { k4, k5, k6, .. } = *self;
        let Self { p1, p2, .. } = *self;
        let r2 = x * x + y * y;
        // Horner's form: few operations, and no large powers.
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let radial = above / below;
        // d radial / d r², times 2.
        let above_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let below_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let growth = 2.0 * ((above_slope - radial * below_slope) / below);
        let seen = [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        // Both mixed derivatives are equal, so the slope is symmetric.
        let across = growth * x * y + 2.0 * (p1 * x + p2 * y);
        let along_x = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
        let along_y = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
        (seen, [[along_x, across], [across, along_y]])
    }
}

/// The numbers that are not 0, as a person reads them.
impl fmt::Display for Distortion {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let names = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];
        let numbers = self.coefficients();
        let shown: Vec<String> = names
            .iter()
            .zip(numbers)
            .filter(|(_, number)| *number != 0.0)
            .map(|(name, number)| format!("{name} = {number}"))
            .collect();
        match (self.fisheye, shown.is_empty()) {
            (false, true) => write!(f, "no distortion"),
            (true, true) => write!(f, "a fisheye"),
            (false, false) => write!(f, "{}", shown.join(", ")),
            (true, false) => write!(f, "a fisheye with {}", shown.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A phone's lens, of the size that photographs have.
    const PHONE: Distortion = Distortion {
        k1: 0.0578421,
        k2: -0.0805099,
        k3: 0.0,
        p1: -0.000980296,
        p2: 0.00015575,
        k4: 0.0,
        k5: 0.0,
        k6: 0.0,
        fisheye: false,
    };

    fn any_lens() -> impl Strategy<Value = Distortion> {
        (
            -0.2..0.2f64,
            -0.05..0.05f64,
            -0.02..0.02f64,
            -0.01..0.01f64,
            -0.01..0.01f64,
            -0.05..0.05f64,
        )
            .prop_map(|(k1, k2, k3, p1, p2, k4)| Distortion {
                k1,
                k2,
                k3,
                p1,
                p2,
                k4,
                k5: 0.3 * k4,
                k6: -0.1 * k4,
                fisheye: false,
            })
    }

    fn any_fisheye() -> impl Strategy<Value = Distortion> {
        (
            -0.05..0.05f64,
            -0.01..0.01f64,
            -0.005..0.005f64,
            -0.001..0.001f64,
        )
            .prop_map(|(k1, k2, k3, k4)| Distortion {
                k1,
                k2,
                k3,
                k4,
                fisheye: true,
                ..Distortion::default()
            })
    }

    proptest! {
        #[test]
        fn undoing_gives_the_point_back(lens in any_lens(), x in -0.6..0.6f64, y in -0.6..0.6f64) {
            let back = lens.undo(lens.apply([x, y])).unwrap();
            prop_assert!((back[0] - x).hypot(back[1] - y) < 1e-11, "{back:?} for {x} {y}");
        }

        #[test]
        fn undoing_a_fisheye_gives_the_point_back(lens in any_fisheye(), x in -3.0..3.0f64, y in -3.0..3.0f64) {
            let back = lens.undo(lens.apply([x, y])).unwrap();
            prop_assert!((back[0] - x).hypot(back[1] - y) < 1e-10, "{back:?} for {x} {y}");
        }

        #[test]
        fn the_slope_is_that_of_finite_differences(lens in any_lens(), x in -0.8..0.8f64, y in -0.8..0.8f64) {
            const STEP: f64 = 1e-5;
            let (_, slope) = lens.with_slope([x, y]);
            for (column, [dx, dy]) in [[STEP, 0.0], [0.0, STEP]].into_iter().enumerate() {
                let more = lens.apply([x + dx, y + dy]);
                let less = lens.apply([x - dx, y - dy]);
                for row in 0..2 {
                    let measured = (more[row] - less[row]) / (2.0 * STEP);
                    prop_assert!((slope[row][column] - measured).abs() < 1e-8, "{row} {column}: {slope:?} {measured}");
                }
            }
        }
    }

    /// `cv2.projectPoints` of the point (0.4, -0.7, 1) with a unit camera and these coefficients,
    /// to six digits, by hand: r² = 0.65, f = 1 + 0.0578421 * 0.65 - 0.0805099 * 0.4225 = 1.003582.
    #[test]
    fn a_known_lens_bends_as_its_formula_says() {
        let [x, y] = PHONE.apply([0.4, -0.7]);
        assert!(
            (x - (0.4 * 1.003582 + 0.000549 + 0.000151)).abs() < 1e-6,
            "{x}"
        );
        assert!(
            (y - (-0.7 * 1.003582 - 0.001598 - 0.000087)).abs() < 1e-6,
            "{y}"
        );
    }

    /// `cv2.fisheye.distortPoints` of (1, 0): an angle of 45 degrees, seen at t (1 + k1 t²).
    #[test]
    fn a_known_fisheye_bends_angles() {
        let lens = Distortion {
            k1: 0.1,
            fisheye: true,
            ..Distortion::default()
        };
        let angle = std::f64::consts::FRAC_PI_4;
        let seen = angle * (1.0 + 0.1 * angle * angle);
        assert!((lens.apply([1.0, 0.0])[0] - seen).abs() < 1e-12);
        assert_eq!(lens.undo([2.0, 0.0]), None, "past 80 degrees");
        assert_eq!(lens.to_string(), "a fisheye with k1 = 0.1");
    }

    #[test]
    fn beyond_the_fold_there_is_nothing() {
        let barrel = Distortion {
            k1: -0.3,
            ..Distortion::default()
        };
        // x (1 - 0.3 x²) is greatest at x = 1.054, where it is 0.703.
        assert!(barrel.undo([0.70, 0.0]).is_some());
        assert_eq!(barrel.undo([0.71, 0.0]), None);
        assert!(barrel.is_before_fold([1.05, 0.0]) && !barrel.is_before_fold([1.06, 0.0]));
        assert!(
            !barrel.is_before_fold([40.0, 0.0]),
            "though turned over twice, it has the sense of the middle"
        );
    }
}
