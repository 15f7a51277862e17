//! Placed solids, and what a line meets among them. Knows nothing of light or cameras.

use glam::{Mat3, Vec3};

use super::shape::{Shape, Touch};
use super::texture::{Material, Surface};

/// Keeps a line that starts on a surface from meeting it again.
const SKIN: f32 = 4e-4;

/// A half-line with a unit direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    from: Vec3,
    along: Vec3,
    /// `1 / along`, for box tests.
    inverse: Vec3,
}

/// A shape of some material, turned and then placed.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    pub(super) shape: Shape,
    pub(super) surface: Surface,
    pub(super) turn: Mat3,
    pub(super) place: Vec3,
}

/// Solids that stand close together, with the box around them.
struct Group {
    low: Vec3,
    high: Vec3,
    solids: Vec<Solid>,
}

/// Everything there is.
pub(super) struct World {
    groups: Vec<Group>,
}

/// A point on a surface.
pub(super) struct Hit {
    pub(super) distance: f32,
    pub(super) point: Vec3,
    /// Unit, on the side that the line came from.
    pub(super) normal: Vec3,
    pub(super) material: Material,
}

impl Line {
    pub(super) fn new(from: Vec3, along: Vec3) -> Line {
        Line { from, along, inverse: along.recip() }
    }

    fn meets_box(&self, low: Vec3, high: Vec3, max: f32) -> bool {
        let (a, b) = ((low - self.from) * self.inverse, (high - self.from) * self.inverse);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        enter <= leave && leave > 0.0 && enter < max
    }
}

impl Solid {
    fn touch(&self, line: &Line, max: f32) -> Option<Touch> {
        let (from, along) = self.localize(line);
        self.shape.touch(from, along, SKIN, max)
    }

    fn localize(&self, line: &Line) -> (Vec3, Vec3) {
        (self.turn.transpose_mul_vec3(line.from - self.place), self.turn.transpose_mul_vec3(line.along))
    }

    /// Low and high corner of a world-aligned box around the solid.
    fn bounds(&self) -> [Vec3; 2] {
        let half = self.turn.abs() * self.shape.half_extent();
        [self.place - half, self.place + half]
    }
}

impl Group {
    fn new(solids: Vec<Solid>) -> Group {
        let low = solids.iter().map(|solid| solid.bounds()[0]).fold(Vec3::INFINITY, Vec3::min);
        let high = solids.iter().map(|solid| solid.bounds()[1]).fold(Vec3::NEG_INFINITY, Vec3::max);
        Group { low, high, solids }
    }
}

impl World {
    pub(super) fn new(groups: Vec<Vec<Solid>>) -> World {
        World { groups: groups.into_iter().map(Group::new).collect() }
    }

    /// The first surface on a line.
    pub(super) fn first_hit(&self, line: &Line) -> Option<Hit> {
        let mut nearest = f32::INFINITY;
        let mut found = None;
        for group in &self.groups {
            if !line.meets_box(group.low, group.high, nearest) {
                continue;
            }
            for solid in &group.solids {
                if let Some((distance, normal)) = solid.touch(line, nearest) {
                    nearest = distance;
                    found = Some((solid, normal));
                }
            }
        }
        found.map(|(solid, normal)| hit(solid, line, nearest, normal))
    }

    /// Whether anything lies on a line before `max`.
    pub(super) fn blocks(&self, line: &Line, max: f32) -> bool {
        let near = self.groups.iter().filter(|group| line.meets_box(group.low, group.high, max));
        near.flat_map(|group| &group.solids).any(|solid| solid.touch(line, max).is_some())
    }
}

fn hit(solid: &Solid, line: &Line, distance: f32, normal: Vec3) -> Hit {
    let (from, along) = solid.localize(line);
    Hit {
        distance,
        point: line.from + distance * line.along,
        normal: solid.turn * normal,
        material: solid.surface.at(from + distance * along, normal),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(x: f32, red: f32) -> Solid {
        Solid {
            shape: Shape::Sphere { radius: 0.5 },
            surface: Surface::Plain { color: Vec3::new(red, 0.0, 0.0), gloss: 0.0 },
            turn: Mat3::IDENTITY,
            place: Vec3::new(x, 0.0, 0.0),
        }
    }

    #[test]
    fn the_nearest_of_several_is_seen_whatever_their_order() {
        let line = Line::new(Vec3::new(-9.0, 0.0, 0.0), Vec3::X);
        for groups in [vec![vec![ball(0.0, 0.1), ball(4.0, 0.2)]], vec![vec![ball(4.0, 0.2)], vec![ball(0.0, 0.1)]]] {
            let hit = World::new(groups).first_hit(&line).unwrap();
            assert_eq!((hit.distance, hit.normal, hit.material.color.x), (8.5, -Vec3::X, 0.1));
        }
    }

    #[test]
    fn only_what_lies_before_the_light_casts_a_shadow() {
        let world = World::new(vec![vec![ball(4.0, 0.2)]]);
        let line = Line::new(Vec3::ZERO, Vec3::X);
        assert!(world.blocks(&line, 5.0));
        assert!(!world.blocks(&line, 3.0));
        assert!(!world.blocks(&Line::new(Vec3::ZERO, Vec3::Y), 5.0));
    }

    #[test]
    fn a_turned_block_is_met_where_its_turned_face_is() {
        let half = Vec3::new(1.0, 0.2, 0.2);
        let surface = Surface::Plain { color: Vec3::ONE, gloss: 0.0 };
        let turn = Mat3::from_rotation_z(std::f32::consts::FRAC_PI_2);
        let world = World::new(vec![vec![Solid { shape: Shape::Block { half }, surface, turn, place: Vec3::Y }]]);
        let hit = world.first_hit(&Line::new(Vec3::new(0.01, 5.0, 0.02), -Vec3::Y)).unwrap();
        assert!((hit.distance - 3.0).abs() < 1e-5 && hit.normal.distance(Vec3::Y) < 1e-5);
    }
}
