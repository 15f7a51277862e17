//! Convex and not so convex solids about the origin, and where a line meets them. Knows nothing of
//! places or colours.

use glam::{Vec2, Vec3};

/// A solid centred on the origin; those with an axis stand along y. Lengths are world units.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Sphere {
        radius: f32,
    },
    Block {
        half: Vec3,
    },
    Cylinder {
        radius: f32,
        half_height: f32,
    },
    /// A cylinder's side alone: one can look into it.
    Tube {
        radius: f32,
        half_height: f32,
    },
    /// A rod with round ends, `half_length` from the middle to an end's centre.
    Capsule {
        radius: f32,
        half_length: f32,
    },
    /// A ring lying flat.
    Torus {
        major: f32,
        minor: f32,
    },
}

/// Where a line meets a shape: the distance along it and the outward unit normal.
pub(super) type Touch = (f32, Vec3);

const TORUS_STEPS: usize = 256;
// About a hundredth of a pixel at the sizes that worlds are made for.
const TORUS_TOLERANCE: f32 = 1e-4;

impl Shape {
    /// Half the size of the box around it.
    pub(super) fn half_extent(&self) -> Vec3 {
        match *self {
            Shape::Sphere { radius } => Vec3::splat(radius),
            Shape::Block { half } => half,
            Shape::Cylinder {
                radius,
                half_height,
            }
            | Shape::Tube {
                radius,
                half_height,
            } => Vec3::new(radius, half_height, radius),
            Shape::Capsule {
                radius,
                half_length,
            } => Vec3::new(radius, half_length + radius, radius),
            Shape::Torus { major, minor } => Vec3::new(major + minor, minor, major + minor),
        }
    }

    /// The first point of the line `from + t * along` (`along` of unit length) on the surface with
    /// `min < t < max`.
    pub(super) fn touch(&self, from: Vec3, along: Vec3, min: f32, max: f32) -> Option<Touch> {
        let within = |(t, _): &Touch| *t > min && *t < max;
        match *self {
            Shape::Sphere { radius } => {
                // Nobody looks from within a solid, so the nearer root is what is seen.
                let t = roots(
                    1.0,
                    from.dot(along),
                    from.length_squared() - radius * radius,
                )?[0];
                Some((t, (from + t * along) / radius)).filter(within)
            }
            Shape::Block { half } => block(from, along, half).filter(within),
            Shape::Cylinder {
                radius,
                half_height,
            } => {
                let side = side(from, along, radius, half_height, min).filter(within);
                nearer(side, cap(from, along, radius, half_height).filter(within))
            }
            Shape::Tube {
                radius,
                half_height,
            } => side(from, along, radius, half_height, min).filter(within),
            Shape::Capsule {
                radius,
                half_length,
            } => capsule(from, along, radius, half_length).filter(within),
            Shape::Torus { major, minor } => torus(from, along, Vec2::new(major, minor), min, max),
        }
    }
}

fn nearer(a: Option<Touch>, b: Option<Touch>) -> Option<Touch> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if a.0 < b.0 { a } else { b }),
        (a, b) => a.or(b),
    }
}

/// Solutions of `a t^2 + 2 b t + c = 0`, the lower first.
fn roots(a: f32, b: f32, c: f32) -> Option<[f32; 2]> {
    let discriminant = b * b - a * c;
    // A line along the axis has a = 0 and meets no side.
    (discriminant > 0.0 && a > 0.0).then(|| {
        let root = discriminant.sqrt();
        [(-b - root) / a, (-b + root) / a]
    })
}

fn block(from: Vec3, along: Vec3, half: Vec3) -> Option<Touch> {
    let inverse = along.recip();
    let a = (-half - from) * inverse;
    let b = (half - from) * inverse;
    let enter = a.min(b);
    let t = enter.max_element();
    (t < a.max(b).min_element()).then(|| {
        // On an edge two axes enter together, and the normal is between both.
        let axis = Vec3::select(enter.cmpeq(Vec3::splat(t)), Vec3::ONE, Vec3::ZERO);
        (t, (-axis * along.signum()).normalize())
    })
}

/// The side of a cylinder, from outside or, past its rim, from within. The normal faces the line's
/// start.
fn side(from: Vec3, along: Vec3, radius: f32, half_height: f32, min: f32) -> Option<Touch> {
    let p = Vec2::new(from.x, from.z);
    let d = Vec2::new(along.x, along.z);
    // With `min`, or a touch behind the start would hide the far wall of a tube.
    let on_side = |t: f32| (t > min && (from.y + t * along.y).abs() < half_height).then_some(t);
    let [enter, leave] = roots(
        d.length_squared(),
        p.dot(d),
        p.length_squared() - radius * radius,
    )?;
    let t = on_side(enter).or_else(|| on_side(leave))?;
    let outward = (p + t * d) / radius;
    // A tube is seen from inside as well, so its normal faces the viewer.
    let facing = -outward.dot(d).signum();
    Some((t, facing * Vec3::new(outward.x, 0.0, outward.y)))
}

fn cap(from: Vec3, along: Vec3, radius: f32, half_height: f32) -> Option<Touch> {
    // The other cap is behind the solid.
    let up = -along.y.signum();
    // A level line makes t infinite or NaN, and the comparison below is false.
    let t = (up * half_height - from.y) / along.y;
    let at = from + t * along;
    (at.x * at.x + at.z * at.z < radius * radius).then_some((t, Vec3::new(0.0, up, 0.0)))
}

fn capsule(from: Vec3, along: Vec3, radius: f32, half_length: f32) -> Option<Touch> {
    let p = Vec2::new(from.x, from.z);
    let d = Vec2::new(along.x, along.z);
    // The round ends lie within the endless cylinder: what misses it misses them.
    let t = roots(
        d.length_squared(),
        p.dot(d),
        p.length_squared() - radius * radius,
    )?[0];
    let y = from.y + t * along.y;
    if y.abs() < half_length {
        let outward = (p + t * d) / radius;
        return Some((t, Vec3::new(outward.x, 0.0, outward.y)));
    }
    // A line inside the cylinder beyond an end meets that end first.
    let to_end = from - Vec3::new(0.0, half_length.copysign(y), 0.0);
    let t = roots(
        1.0,
        to_end.dot(along),
        to_end.length_squared() - radius * radius,
    )?[0];
    Some((t, (to_end + t * along) / radius))
}

/// Sphere tracing: the distance to a torus is known, so that far is safe to go. (major, minor)
/// radii.
fn torus(from: Vec3, along: Vec3, radii: Vec2, min: f32, max: f32) -> Option<Touch> {
    let reach = radii.x + radii.y;
    // Walked only within the sphere around it.
    let [enter, leave] = roots(1.0, from.dot(along), from.length_squared() - reach * reach)?;
    let mut t = enter.max(min);
    let last = leave.min(max);
    for _ in 0..TORUS_STEPS {
        if t > last {
            return None;
        }
        let at = from + t * along;
        let ring = Vec3::new(at.x, 0.0, at.z).normalize_or_zero() * radii.x;
        let distance = at.distance(ring) - radii.y;
        if distance < TORUS_TOLERANCE {
            return Some((t, (at - ring).normalize()));
        }
        // Nothing is nearer than the distance, so a step of it passes over nothing.
        t += distance;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHAPES: [Shape; 6] = [
        Shape::Sphere { radius: 0.7 },
        Shape::Block {
            half: Vec3::new(0.3, 0.5, 0.7),
        },
        Shape::Cylinder {
            radius: 0.4,
            half_height: 0.6,
        },
        Shape::Tube {
            radius: 0.4,
            half_height: 0.6,
        },
        Shape::Capsule {
            radius: 0.2,
            half_length: 0.5,
        },
        Shape::Torus {
            major: 0.5,
            minor: 0.2,
        },
    ];

    /// Signed distance to each shape, by formulas that share nothing with the intersections.
    fn distance(shape: &Shape, p: Vec3) -> f32 {
        let axis_distance = Vec2::new(p.x, p.z).length();
        let boxed = |q: Vec2| q.max(Vec2::ZERO).length() + q.max_element().min(0.0);
        match *shape {
            Shape::Sphere { radius } => p.length() - radius,
            Shape::Block { half } => {
                let q = p.abs() - half;
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
            }
            Shape::Cylinder {
                radius,
                half_height,
            } => boxed(Vec2::new(axis_distance - radius, p.y.abs() - half_height)),
            Shape::Tube {
                radius,
                half_height,
            } => boxed(Vec2::new(
                (axis_distance - radius).abs(),
                p.y.abs() - half_height,
            )),
            Shape::Capsule {
                radius,
                half_length,
            } => p.distance(Vec3::new(0.0, p.y.clamp(-half_length, half_length), 0.0)) - radius,
            Shape::Torus { major, minor } => Vec2::new(axis_distance - major, p.y).length() - minor,
        }
    }

    proptest! {
        #[test]
        fn a_touch_is_the_first_point_on_the_surface(
            which in 0..SHAPES.len(),
            from in prop::array::uniform3(-1.0..1.0f32),
            to in prop::array::uniform3(-0.6..0.6f32),
        ) {
            let shape = SHAPES[which];
            let from = Vec3::from(from).normalize_or(Vec3::X) * 2.5;
            let along = (Vec3::from(to) - from).normalize();
            let touch = shape.touch(from, along, 0.0, 10.0);
            let end = touch.map_or(5.0, |(t, _)| t);
            for i in 0..500 {
                let t = end * i as f32 / 500.0;
                let clear = distance(&shape, from + t * along);
                prop_assert!(clear > -2e-3, "{shape:?}: {clear} inside at {t}, before {touch:?}");
            }
            if let Some((t, normal)) = touch {
                prop_assert!(distance(&shape, from + t * along).abs() < 2e-3, "{shape:?}: not on the surface");
                prop_assert!((normal.length() - 1.0).abs() < 1e-4);
                prop_assert!(normal.dot(along) <= 1e-3, "{shape:?}: the normal faces away");
                let out = distance(&shape, from + t * along + 0.01 * normal);
                prop_assert!((out - 0.01).abs() < 4e-3, "{shape:?}: the normal leads to {out} outside");
                prop_assert!(shape.touch(from, along, 0.0, t - 1e-3).is_none(), "nothing nearer");
            }
        }
    }

    #[test]
    fn lines_through_the_middle_meet_every_shape_that_has_one() {
        for (shape, t) in SHAPES.iter().zip([1.3, 1.7, 1.6, 1.6, 1.8, 1.3]) {
            let (at, normal) = shape
                .touch(Vec3::new(1e-4, 0.0, 2.0), -Vec3::Z, 0.0, 9.0)
                .unwrap();
            let want = if matches!(shape, Shape::Block { .. }) {
                1.3
            } else {
                t
            };
            assert!((at - want).abs() < 1e-3, "{shape:?} at {at}");
            assert!(normal.distance(Vec3::Z) < 1e-2, "{shape:?}: {normal}");
        }
    }

    #[test]
    fn one_looks_into_a_tube_but_not_into_a_cylinder() {
        let from = Vec3::new(0.0, 1.6, 0.0);
        let along = Vec3::new(0.2, -1.0, 0.0).normalize();
        let (_, inner) = SHAPES[3].touch(from, along, 0.0, 9.0).unwrap();
        assert!(
            inner.distance(-Vec3::X) < 1e-4,
            "the far wall from within: {inner}"
        );
        let (_, top) = SHAPES[2].touch(from, along, 0.0, 9.0).unwrap();
        assert_eq!(top, Vec3::Y);
    }
}
