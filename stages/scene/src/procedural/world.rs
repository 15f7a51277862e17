//! Placed solids, and what a line meets among them. Knows nothing of light or cameras.

use glam::{Mat3, Vec3, Vec3A};

use super::shape::{Shape, Touch};
use super::texture::{Material, Surface};

/// Keeps a line that starts on a surface from meeting it again.
const SKIN: f32 = 4e-4;

/// A half-line with a unit direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    from: Vec3,
    along: Vec3,
    /// The start and `1 / along` once more, as box tests want them.
    start: Vec3A,
    inverse: Vec3A,
}

/// A shape of some material, turned and then placed.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    pub(super) shape: Shape,
    pub(super) surface: Surface,
    pub(super) turn: Mat3,
    pub(super) place: Vec3,
}

/// Solids that stand close together, each with its own box.
struct Group {
    bounds: Bounds,
    solids: Vec<(Bounds, Solid)>,
}

/// Everything there is: a backdrop, and the things before it.
pub(super) struct World {
    backdrop: Vec<Solid>,
    bounds: Bounds,
    things: Vec<Group>,
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
        Line {
            from,
            along,
            start: from.into(),
            // An axis that the line does not follow gives infinity, which the box test takes as it
            // should.
            inverse: Vec3A::from(along).recip(),
        }
    }
}

/// A box along the world's axes.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    /// The box around nothing.
    const EMPTY: Bounds = Bounds {
        low: Vec3A::INFINITY,
        high: Vec3A::NEG_INFINITY,
    };

    fn around(self, other: Bounds) -> Bounds {
        Bounds {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Whether a line passes through the box before `max`.
    fn meets(&self, line: &Line, max: f32) -> bool {
        let a = (self.low - line.start) * line.inverse;
        let b = (self.high - line.start) * line.inverse;
        let enter = a.min(b).max_element();
        let leave = a.max(b).min_element();
        enter <= leave && leave > 0.0 && enter < max
    }
}

impl Solid {
    fn touch(&self, line: &Line, max: f32) -> Option<Touch> {
        let (from, along) = self.localize(line);
        self.shape.touch(from, along, SKIN, max)
    }

    fn localize(&self, line: &Line) -> (Vec3, Vec3) {
        (
            // A rotation's transpose is its inverse.
            self.turn.transpose_mul_vec3(line.from - self.place),
            self.turn.transpose_mul_vec3(line.along),
        )
    }

    fn bounds(&self) -> Bounds {
        // The box around a turned box: |R| times its half extents.
        let half = Vec3A::from(self.turn.abs() * self.shape.half_extent());
        let middle = Vec3A::from(self.place);
        Bounds {
            low: middle - half,
            high: middle + half,
        }
    }
}

impl Group {
    fn new(solids: Vec<Solid>) -> Group {
        let solids: Vec<_> = solids
            .into_iter()
            .map(|solid| (solid.bounds(), solid))
            .collect();
        Group {
            bounds: solids
                .iter()
                .map(|(bounds, _)| *bounds)
                .fold(Bounds::EMPTY, Bounds::around),
            solids,
        }
    }
}

impl World {
    /// The backdrop casts no shadows: it must lie behind all things as seen from every light.
    /// Groups of things are found the faster the less their boxes overlap.
    pub(super) fn new(backdrop: Vec<Solid>, things: Vec<Vec<Solid>>) -> World {
        let things: Vec<Group> = things.into_iter().map(Group::new).collect();
        let bounds = things
            .iter()
            .map(|group| group.bounds)
            .fold(Bounds::EMPTY, Bounds::around);
        World {
            backdrop,
            bounds,
            things,
        }
    }

    /// The first surface on a line.
    pub(super) fn first_hit(&self, line: &Line) -> Option<Hit> {
        let first = self
            .backdrop
            .iter()
            .fold(None, |found, solid| nearer(found, solid, line));
        let (solid, (distance, normal)) = self
            .near(line, f32::INFINITY)
            .fold(first, |found, solid| nearer(found, solid, line))?;
        Some(hit(solid, line, distance, normal))
    }

    /// Whether a thing lies on a line before `max`.
    pub(super) fn shades(&self, line: &Line, max: f32) -> bool {
        self.near(line, max)
            .any(|solid| solid.touch(line, max).is_some())
    }

    /// The things whose boxes a line meets before `max`.
    fn near(&self, line: &Line, max: f32) -> impl Iterator<Item = &Solid> {
        // Many rays meet no thing at all: one test of the box around all spares the others.
        let groups: &[Group] = if self.bounds.meets(line, max) {
            &self.things
        } else {
            &[]
        };
        let groups = groups
            .iter()
            .filter(move |group| group.bounds.meets(line, max));
        groups
            .flat_map(|group| &group.solids)
            .filter(move |(bounds, _)| bounds.meets(line, max))
            .map(|(_, solid)| solid)
    }
}

/// The nearer of what was found and where `line` meets `solid`.
fn nearer<'a>(
    found: Option<(&'a Solid, Touch)>,
    solid: &'a Solid,
    line: &Line,
) -> Option<(&'a Solid, Touch)> {
    // What is further than the nearest so far need not be computed.
    let max = found.map_or(f32::INFINITY, |(_, (distance, _))| distance);
    solid.touch(line, max).map(|touch| (solid, touch)).or(found)
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
            surface: Surface::Plain {
                color: Vec3::new(red, 0.0, 0.0),
                gloss: 0.0,
            },
            turn: Mat3::IDENTITY,
            place: Vec3::new(x, 0.0, 0.0),
        }
    }

    #[test]
    fn the_nearest_of_several_is_seen_whatever_their_order() {
        let line = Line::new(Vec3::new(-9.0, 0.0, 0.0), Vec3::X);
        let near = || ball(0.0, 0.1);
        let far = || ball(4.0, 0.2);
        for world in [
            World::new(vec![], vec![vec![near(), far()]]),
            World::new(vec![], vec![vec![far()], vec![near()]]),
            World::new(vec![near()], vec![vec![far()]]),
            World::new(vec![far(), near()], vec![]),
        ] {
            let hit = world.first_hit(&line).unwrap();
            assert_eq!(
                (hit.distance, hit.normal, hit.material.color.x),
                (8.5, -Vec3::X, 0.1)
            );
        }
    }

    #[test]
    fn only_things_before_the_light_cast_shadows() {
        let world = World::new(vec![ball(1.0, 0.1)], vec![vec![ball(4.0, 0.2)]]);
        let line = Line::new(Vec3::ZERO, Vec3::X);
        assert!(world.shades(&line, 5.0));
        assert!(!world.shades(&line, 3.0));
        assert!(!world.shades(&Line::new(Vec3::ZERO, Vec3::Y), 5.0));
    }

    #[test]
    fn a_turned_block_is_met_where_its_turned_face_is() {
        let half = Vec3::new(1.0, 0.2, 0.2);
        let surface = Surface::Plain {
            color: Vec3::ONE,
            gloss: 0.0,
        };
        let turn = Mat3::from_rotation_z(std::f32::consts::FRAC_PI_2);
        let world = World::new(
            vec![],
            vec![vec![Solid {
                shape: Shape::Block { half },
                surface,
                turn,
                place: Vec3::Y,
            }]],
        );
        let hit = world
            .first_hit(&Line::new(Vec3::new(0.01, 5.0, 0.02), -Vec3::Y))
            .unwrap();
        assert!((hit.distance - 3.0).abs() < 1e-5 && hit.normal.distance(Vec3::Y) < 1e-5);
    }
}
