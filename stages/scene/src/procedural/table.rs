//! The things on the table: where each stands and what it is made of. Knows nothing of light or
//! cameras.
//!
//! The table's top is y = 0, the wall stands behind at z = -1.25, and the cameras look from +z. At
//! 256x192 a pixel is 0.009 units wide where the things stand, so wires of 0.010, letters with
//! strokes of 0.009 to 0.014, joints of 0.013 and the star's inner spokes are there to see, and are
//! gone at a quarter of that.

use compute::Rng;
use glam::{Mat3, Vec2, Vec3, vec2, vec3};

use super::glyphs::Text;
use super::room::room;
use super::shape::Shape;
use super::solids::{block, rod, solid, wire_ball};
use super::texture::{Surface, hex};
use super::world::{Solid, World};

/// The world of `seed`: the same things, each turned a little differently.
pub(super) fn still_life(seed: u64) -> World {
    let rng = Rng::new(seed, "still life: turns");
    // By number: a thing that is added turns no other.
    let turn = |thing: u64, about: f32| {
        Mat3::from_rotation_y(about + 0.16 * (rng.uniform(0, thing) - 0.5))
    };
    let things = vec![
        vec![panel(turn(0, 0.28))],
        books(turn(1, -0.3), turn(2, -0.12), turn(3, -0.45)),
        pencils(turn(4, 0.0)),
        wire_ball(turn(5, 0.4), vec3(0.16, 0.21, 0.28)),
        vec![checkered_ball(turn(6, 0.9))],
        letter_blocks([turn(7, 0.25), turn(8, -0.2), turn(9, 0.1), turn(10, 0.5)]),
        vec![ring(turn(11, 0.3))],
        vec![tin(turn(12, 0.0))],
    ];
    World::new(room(), things)
}

/// A leaning sheet of text.
fn panel(turn: Mat3) -> Solid {
    let heading = Text::centred("SHARP", vec2(0.0, 0.285), 0.0185);
    let lines = vec![
        "A FIELD OF",
        "LIGHT SEEN",
        "FROM MANY",
        "SIDES - CAN",
        "YOU READ IT?",
    ];
    let body = Text {
        lines,
        top_left: vec2(-0.315, 0.115),
        cell: 0.0089,
    };
    let surface = Surface::Print {
        paper: hex(0xf3e7c9),
        ink: hex(0x2b2a33),
        texts: vec![heading, body],
        star: None,
    };
    let half = vec3(0.36, 0.325, 0.012);
    let lean = Mat3::from_rotation_x(-0.22);
    solid(
        block(half),
        surface,
        turn * lean,
        // It leans by 0.22 rad, whose cosine is 0.98: its lower edge stands on the table.
        vec3(-0.54, half.y * 0.98, -0.45),
    )
}

/// Three books in a pile.
fn books(low: Mat3, middle: Mat3, high: Mat3) -> Vec<Solid> {
    let book = |half: Vec3, cloth, foil, name, cell: f32, turn, bottom: f32| {
        let title = Text::centred(name, vec2(0.0, 3.5 * cell), cell);
        let surface = Surface::Book {
            cloth: hex(cloth),
            foil: hex(foil),
            title,
            half,
            cover: 0.009,
        };
        solid(
            block(half),
            surface,
            turn,
            vec3(0.33, bottom + half.y, -0.6),
        )
    };
    vec![
        book(
            vec3(0.33, 0.060, 0.23),
            0x1f4a6b,
            0xe8cf8a,
            "RADIANCE",
            0.0098,
            low,
            0.0,
        ),
        book(
            vec3(0.29, 0.050, 0.20),
            0x8c2f39,
            0xf0dfb5,
            "VIEWS AND RAYS",
            0.0050,
            middle,
            0.12,
        ),
        book(
            vec3(0.26, 0.045, 0.18),
            0x3f6b4a,
            0xf3ecd2,
            "GRIDS",
            0.0090,
            high,
            0.22,
        ),
    ]
}

/// A cup of pencils.
fn pencils(turn: Mat3) -> Vec<Solid> {
    let cup = Surface::Stripes {
        colors: [hex(0x2f5d73), hex(0xdfe5e3)],
        width: 0.022,
        gloss: 0.4,
    };
    let at = vec3(0.86, 0.0, -0.38);
    let tube = Shape::Tube {
        radius: 0.105,
        half_height: 0.13,
    };
    let mut things = vec![solid(tube, cup, turn, at + vec3(0.0, 0.13, 0.0))];
    let colors = [0xd9a521, 0xb8322a, 0x2d7a3e, 0x2c4f9e, 0xe07b2e, 0x55317a];
    for (i, color) in colors.into_iter().enumerate() {
        let around = i as f32 * std::f32::consts::TAU / 6.0;
        let foot = at + 0.05 * outward(around + 2.6);
        let rim = at + 0.085 * outward(around);
        let head =
            foot + (rim + Vec3::Y * 0.25 - foot).normalize() * (0.45 + 0.025 * (i % 3) as f32);
        let surface = Surface::Stripes {
            colors: [hex(color), hex(color) * 0.6],
            width: 0.05,
            gloss: 0.3,
        };
        things.push(rod(foot + Vec3::Y * 0.02, head, 0.0125, surface.clone()));
        let lead = Surface::Plain {
            color: hex(0xe6c79a),
            gloss: 0.0,
        };
        things.push(rod(
            head,
            head + (head - foot).normalize() * 0.022,
            0.007,
            lead,
        ));
    }
    things
        .into_iter()
        .map(|thing| turned_about(thing, turn, at))
        .collect()
}

fn outward(around: f32) -> Vec3 {
    vec3(around.cos(), 0.0, around.sin())
}

fn turned_about(thing: Solid, turn: Mat3, at: Vec3) -> Solid {
    Solid {
        place: at + turn * (thing.place - at),
        turn: turn * thing.turn,
        ..thing
    }
}

fn checkered_ball(turn: Mat3) -> Solid {
    let colors = [hex(0xf2efe6), hex(0xc0392f)];
    let radius = 0.17;
    let tilt = Mat3::from_rotation_z(0.35);
    let surface = Surface::Checker {
        colors,
        count: 14.0,
        gloss: 0.9,
    };
    solid(
        Shape::Sphere { radius },
        surface,
        turn * tilt,
        vec3(0.62, radius, 0.22),
    )
}

/// N, E and R in a row, F on top.
fn letter_blocks(turns: [Mat3; 4]) -> Vec<Solid> {
    const HALF: f32 = 0.088;
    let things = [
        ("N", 0x2c5fa8, vec3(-0.80, HALF, 0.12)),
        ("E", 0xc23b2e, vec3(-0.55, HALF, 0.22)),
        ("R", 0x2f8044, vec3(-0.29, HALF, 0.28)),
        ("F", 0xd98a1f, vec3(-0.66, 3.0 * HALF, 0.17)),
    ];
    let cell = HALF * 0.155;
    let make = |((name, paint, place), turn): ((&'static str, u32, Vec3), Mat3)| {
        let letter = Text::centred(name, Vec2::new(0.0, 3.5 * cell), cell);
        let surface = Surface::Letter {
            paint: hex(paint),
            wood: hex(0xe6c896),
            letter,
            half: HALF,
        };
        solid(block(Vec3::splat(HALF)), surface, turn, place)
    };
    things.into_iter().zip(turns).map(make).collect()
}

/// A striped ring that leans on the pile of books.
fn ring(turn: Mat3) -> Solid {
    let surface = Surface::Twist {
        colors: [hex(0xe9b949), hex(0x28566b)],
        count: 18.0,
    };
    solid(
        Shape::Torus {
            major: 0.11,
            minor: 0.034,
        },
        surface,
        turn,
        // The pile of books is 0.31 high.
        vec3(0.33, 0.31 + 0.034, -0.6),
    )
}

fn tin(turn: Mat3) -> Solid {
    let surface = Surface::Stripes {
        colors: [hex(0xd7dadb), hex(0x9aa2a6)],
        width: 0.012,
        gloss: 0.7,
    };
    solid(
        Shape::Cylinder {
            radius: 0.085,
            half_height: 0.11,
        },
        surface,
        turn,
        vec3(-1.02, 0.11, -0.30),
    )
}
