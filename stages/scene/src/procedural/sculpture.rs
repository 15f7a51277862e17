//! A small monument that stands alone: what the world `object` is made of. Knows nothing of light
//! or cameras.
//!
//! It fits into a ball of radius 1.2 about the origin, y up. Seen from 4 units with 400 pixels a
//! pixel is 0.007 units wide: joints of 0.013, wires of 0.010 and the finer letters are there to
//! see, and are gone at a quarter of that.

use glam::{Mat3, Vec3, vec2, vec3};

use super::glyphs::Text;
use super::shape::Shape;
use super::solids::{block, rod, solid, wire_ball};
use super::texture::{Surface, hex};
use super::world::{Solid, World};

/// The top of the base.
const FLOOR: f32 = -0.62;

/// A round base with a plinth of bricks; on it a block of letters that carries a ball; around it
/// posts with wires between them, a ring, a cage of wire and a slate of print.
pub(super) fn sculpture() -> World {
    let things = vec![
        base(),
        plinth(),
        posts(),
        // Around the plinth's ball, which is seen through the wires.
        wire_ball(Mat3::from_rotation_y(0.4), vec3(0.0, 0.55, 0.0)),
        slate(),
    ];
    World::new(Vec::new(), things)
}

fn base() -> Vec<Solid> {
    let wood = Surface::Wood {
        light: hex(0xc99a63),
        dark: hex(0x7a4a25),
        width: 0.22,
    };
    let rim = Surface::Twist {
        colors: [hex(0xe9b949), hex(0x28566b)],
        count: 48.0,
    };
    let disc = Shape::Cylinder {
        radius: 1.0,
        half_height: 0.06,
    };
    vec![
        solid(disc, wood, Mat3::IDENTITY, vec3(0.0, FLOOR - 0.06, 0.0)),
        solid(
            Shape::Torus {
                major: 0.93,
                minor: 0.05,
            },
            rim,
            Mat3::IDENTITY,
            vec3(0.0, FLOOR + 0.03, 0.0),
        ),
    ]
}

fn plinth() -> Vec<Solid> {
    let brick = Surface::Brick {
        brick: hex(0xbf7a5c),
        mortar: hex(0xd8cfc0),
        size: vec2(0.17, 0.075),
    };
    let letter = |name, half: f32| {
        let cell = half * 0.155;
        let letter = Text::centred(name, vec2(0.0, 3.5 * cell), cell);
        Surface::Letter {
            paint: hex(0x2c5fa8),
            wood: hex(0xe6c896),
            letter,
            half,
        }
    };
    let ball = Surface::Checker {
        colors: [hex(0xf2efe6), hex(0xc0392f)],
        count: 14.0,
        gloss: 0.9,
    };
    let tin = Surface::Stripes {
        colors: [hex(0xd7dadb), hex(0x9aa2a6)],
        width: 0.014,
        gloss: 0.7,
    };
    vec![
        solid(
            block(vec3(0.36, 0.2, 0.36)),
            brick,
            Mat3::IDENTITY,
            vec3(0.0, FLOOR + 0.2, 0.0),
        ),
        solid(
            block(Vec3::splat(0.19)),
            letter("R", 0.19),
            Mat3::from_rotation_y(0.7),
            vec3(0.0, FLOOR + 0.59, 0.0),
        ),
        solid(
            Shape::Cylinder {
                radius: 0.12,
                half_height: 0.05,
            },
            tin,
            Mat3::IDENTITY,
            vec3(0.0, FLOOR + 0.83, 0.0),
        ),
        solid(
            Shape::Sphere { radius: 0.11 },
            ball,
            Mat3::from_rotation_z(0.35),
            vec3(0.0, 0.55, 0.0),
        ),
    ]
}

/// Four posts with glossy heads, and a wire from each to the next.
fn posts() -> Vec<Solid> {
    let corner = |i: i32| {
        let around = (f64::from(i) + 0.5) as f32 * std::f32::consts::FRAC_PI_2;
        vec3(0.66 * around.cos(), FLOOR, 0.66 * around.sin())
    };
    let stripes = |color| Surface::Stripes {
        colors: [hex(color), hex(0xdfe5e3)],
        width: 0.035,
        gloss: 0.4,
    };
    let wire = Surface::Plain {
        color: hex(0x2a2d33),
        gloss: 0.8,
    };
    let colors = [0x2f5d73, 0xb8322a, 0x2d7a3e, 0x55317a];
    let post = |(i, color): (i32, u32)| {
        let foot = corner(i);
        let next = corner(i + 1);
        let head = foot + 0.62 * Vec3::Y;
        let gold = Surface::Plain {
            color: hex(0xd9a521),
            gloss: 1.0,
        };
        vec![
            rod(foot, head, 0.045, stripes(color)),
            solid(
                Shape::Sphere { radius: 0.085 },
                gold,
                Mat3::IDENTITY,
                head + 0.09 * Vec3::Y,
            ),
            rod(
                head - 0.1 * Vec3::Y,
                next + 0.52 * Vec3::Y,
                0.006,
                wire.clone(),
            ),
            rod(
                head - 0.3 * Vec3::Y,
                next + 0.32 * Vec3::Y,
                0.006,
                wire.clone(),
            ),
        ]
    };
    (0..).zip(colors).flat_map(post).collect()
}

/// A leaning sheet of print, and a ring beside it.
fn slate() -> Vec<Solid> {
    let body = Text {
        lines: vec!["FROM ALL", "AROUND"],
        top_left: vec2(-0.23, 0.115),
        cell: 0.0098,
    };
    let surface = Surface::Print {
        paper: hex(0xf3e7c9),
        ink: hex(0x2b2a33),
        texts: vec![body],
        star: None,
    };
    let half = vec3(0.27, 0.16, 0.012);
    let lean = Mat3::from_rotation_y(0.1) * Mat3::from_rotation_x(-0.3);
    let twist = Surface::Twist {
        colors: [hex(0xc23b2e), hex(0xf0dfb5)],
        count: 18.0,
    };
    vec![
        solid(block(half), surface, lean, vec3(0.0, FLOOR + half.y, 0.62)),
        solid(
            Shape::Torus {
                major: 0.14,
                minor: 0.045,
            },
            twist,
            Mat3::from_rotation_x(0.9),
            vec3(0.0, FLOOR + 0.15, -0.6),
        ),
    ]
}
