//! Solids that more than one world has: blocks, rods and balls of wire. Knows nothing of where they
//! stand.

use glam::{Mat3, Vec3, vec3};

use super::shape::Shape;
use super::texture::{Surface, hex};
use super::world::Solid;

pub(super) fn solid(shape: Shape, surface: Surface, turn: Mat3, place: Vec3) -> Solid {
    Solid {
        shape,
        surface,
        turn,
        place,
    }
}

pub(super) fn block(half: Vec3) -> Shape {
    Shape::Block { half }
}

/// A capsule from point to point.
pub(super) fn rod(from: Vec3, to: Vec3, radius: f32, surface: Surface) -> Solid {
    let (along, length) = (to - from).normalize_and_length();
    // A capsule is round and its patterns run along it, so any side serves.
    let side = along.any_orthonormal_vector();
    let turn = Mat3::from_cols(side, along, side.cross(along));
    solid(
        Shape::Capsule {
            radius,
            half_length: length / 2.0,
        },
        surface,
        turn,
        (from + to) / 2.0,
    )
}

/// The thirty edges of an icosahedron in thin wire.
pub(super) fn wire_ball(turn: Mat3, middle: Vec3) -> Vec<Solid> {
    const SIZE: f32 = 0.11;
    let golden = (1.0 + 5f32.sqrt()) / 2.0;
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let corners: Vec<Vec3> = signs
        .into_iter()
        .flat_map(|(a, b)| {
            [
                vec3(0.0, a, b * golden),
                vec3(a, b * golden, 0.0),
                vec3(b * golden, 0.0, a),
            ]
        })
        .collect();
    let wire = Surface::Plain {
        color: hex(0x2a2d33),
        gloss: 0.8,
    };
    let place = |corner: Vec3| middle + turn * corner * SIZE;
    let pairs = corners
        .iter()
        .enumerate()
        .flat_map(|(i, a)| corners[i + 1..].iter().map(move |b| (*a, *b)));
    // Neighbouring corners of this icosahedron are 2 apart, all others more than 3.
    pairs
        .filter(|(a, b)| a.distance(*b) < 2.5)
        .map(|(a, b)| rod(place(a), place(b), 0.005, wire.clone()))
        .collect()
}
