//! What stands behind the things on the table: wall, poster and the table itself.

use glam::{Mat3, vec2, vec3};

use super::glyphs::Text;
use super::solids::{block, solid};
use super::texture::{Star, Surface, hex};
use super::world::Solid;

const WALL_Z: f32 = -1.25;

/// Wall, poster and table: what is behind everything, and so casts no shadow on anything.
pub(super) fn room() -> Vec<Solid> {
    let brick = Surface::Brick {
        brick: hex(0xbf7a5c),
        mortar: hex(0xd8cfc0),
        size: vec2(0.235, 0.082),
    };
    let wood = Surface::Wood {
        light: hex(0xc99a63),
        dark: hex(0x7a4a25),
        width: 0.3,
    };
    vec![
        solid(
            block(vec3(4.5, 2.5, 0.1)),
            brick,
            Mat3::IDENTITY,
            vec3(0.0, 1.5, WALL_Z - 0.1),
        ),
        solid(
            block(vec3(4.5, 0.05, 2.2)),
            wood,
            Mat3::IDENTITY,
            vec3(0.0, -0.05, WALL_Z + 2.2),
        ),
        poster(),
    ]
}

/// A resolution chart on the wall.
fn poster() -> Solid {
    let line = |text, y, cell| Text::centred(text, vec2(0.20, y), cell);
    let texts = vec![
        line("E F P", 0.225, 0.0150),
        line("T O Z L", 0.085, 0.0110),
        line("P E C F D", -0.025, 0.0090),
        line("E D F C Z P", -0.12, 0.0075),
        line("F E L O P Z D", -0.20, 0.0062),
    ];
    let star = Star {
        middle: vec2(-0.265, 0.0),
        radius: 0.175,
        spokes: 24.0,
    };
    let surface = Surface::Print {
        paper: hex(0xf1ede2),
        ink: hex(0x24262b),
        texts,
        star: Some(star),
    };
    solid(
        block(vec3(0.49, 0.275, 0.008)),
        surface,
        Mat3::IDENTITY,
        vec3(0.36, 0.86, WALL_Z + 0.008),
    )
}
