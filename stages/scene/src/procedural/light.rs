//! Lamps, shadows and reflection. Knows nothing of pixels.
//!
//! The world is lit by two sets of points that stand for extended lights: a warm lamp and the cool
//! sky of a large window. They are fixed in the world, so that penumbrae look the same from every
//! camera: what a radiance field must learn is really there.

use glam::{Vec2, Vec3};

use super::texture::hex;
use super::world::{Hit, Line, World};

/// Points in each set. A sample looks at `PER_SAMPLE` of them; sixteen samples see each once.
const POINTS: usize = 32;
const PER_SAMPLE: usize = 2;
/// Light that comes from everywhere and casts no shadow, as bounced off the room.
const BOUNCE: Vec3 = Vec3::new(0.085, 0.078, 0.072);
const SHININESS: i32 = 64;

/// An extended light of equal points.
struct Luminaire {
    points: Vec<Vec3>,
    color: Vec3,
    /// Whether glossy surfaces mirror it.
    highlights: bool,
}

/// All lights of the world.
pub(super) struct Lights {
    luminaires: [Luminaire; 2],
}

impl Lights {
    /// The lamp, and a large window above and before the table.
    pub(super) fn room() -> Lights {
        Lights::lamp_and(0.5)
    }

    /// The lamp, and an open sky all around.
    pub(super) fn around() -> Lights {
        Lights::lamp_and(1.0)
    }

    /// `turn`: how much of the horizon the sky covers.
    fn lamp_and(turn: f32) -> Lights {
        let sky = |u| sky(u, turn);
        Lights {
            luminaires: [
                Luminaire {
                    points: spread(lamp),
                    color: hex(0xfff0dc) * 0.95,
                    highlights: true,
                },
                Luminaire {
                    points: spread(sky),
                    color: hex(0xdfeaff) * 0.52,
                    highlights: false,
                },
            ],
        }
    }

    /// Linear radiance from a point towards the eye. `sample` counts a pixel's samples: the average
    /// over every sixteen in a row weighs all points of all lights alike.
    pub(super) fn shade(&self, world: &World, hit: &Hit, to_eye: Vec3, sample: usize) -> Vec3 {
        let direct: Vec3 = self
            .luminaires
            .iter()
            .map(|light| light.reflected(world, hit, to_eye, sample))
            .sum();
        direct + hit.material.color * BOUNCE * (1.3 + 0.7 * hit.normal.y)
    }
}

impl Luminaire {
    fn reflected(&self, world: &World, hit: &Hit, to_eye: Vec3, sample: usize) -> Vec3 {
        let stride = POINTS / PER_SAMPLE;
        // Other points for each sub-ray: together they see all of the lamp.
        // 7 is odd: sixteen samples in a row meet all points, and neighbours look at distant ones.
        let points = (0..PER_SAMPLE).map(|k| self.points[(sample * 7 + k * stride) % POINTS]);
        let sum: Vec3 = points
            .map(|point| self.point_reflected(world, hit, to_eye, point))
            .sum();
        sum / PER_SAMPLE as f32
    }

    /// Lambert's law and a highlight after Blinn and Phong (Blinn 1977).
    fn point_reflected(&self, world: &World, hit: &Hit, to_eye: Vec3, light: Vec3) -> Vec3 {
        let (to_light, distance) = (light - hit.point).normalize_and_length();
        // Lambert's cosine first: it spares the shadow ray of half of all points.
        let cosine = hit.normal.dot(to_light);
        if cosine <= 0.0 || world.shades(&Line::new(hit.point, to_light), distance) {
            return Vec3::ZERO;
        }
        let mirrored = hit.normal.dot((to_light + to_eye).normalize()).max(0.0);
        let highlight = if self.highlights {
            hit.material.gloss * mirrored.powi(SHININESS)
        } else {
            0.0
        };
        self.color * (hit.material.color + highlight) * cosine
    }
}

/// A square before the table, to the left, that faces the things.
fn lamp(u: Vec2) -> Vec3 {
    let right = Vec3::new(0.68, 0.0, 0.51);
    let up = Vec3::new(-0.26, 0.72, 0.34);
    Vec3::new(-2.6, 3.3, 2.3) + (u.x - 0.5) * right + (u.y - 0.5) * up
}

/// Part of the upper half of a large sphere: with half a turn, what is above and before the table.
fn sky(u: Vec2, turn: f32) -> Vec3 {
    let turn = std::f32::consts::TAU * turn * u.x;
    let up = 0.15 + 0.85 * u.y;
    let out = (1.0 - up * up).max(0.0).sqrt();
    9.0 * Vec3::new(out * turn.cos(), up, out * turn.sin() - 0.05)
}

/// Evenly spread points of the unit square (Hammersley's set), placed.
fn spread(place: impl Fn(Vec2) -> Vec3) -> Vec<Vec3> {
    // Hammersley's points: the bits of i reversed spread evenly for any number of them.
    let mirrored = |i: usize| (i as u32).reverse_bits() as f32 / (1u64 << 32) as f32;
    (0..POINTS)
        .map(|i| place(Vec2::new((i as f32 + 0.5) / POINTS as f32, mirrored(i))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::shape::Shape;
    use super::super::texture::{Material, Surface};
    use super::super::world::Solid;
    use super::*;
    use glam::Mat3;

    fn floor(gloss: f32) -> Hit {
        let material = Material {
            color: Vec3::splat(0.5),
            gloss,
        };
        Hit {
            distance: 1.0,
            point: Vec3::ZERO,
            normal: Vec3::Y,
            material,
        }
    }

    fn pixel(world: &World, hit: &Hit, to_eye: Vec3, first: usize) -> Vec3 {
        let lights = Lights::room();
        (first..first + 16)
            .map(|sample| lights.shade(world, hit, to_eye, sample))
            .sum::<Vec3>()
            / 16.0
    }

    fn ball(place: Vec3) -> World {
        let surface = Surface::Plain {
            color: Vec3::ONE,
            gloss: 0.0,
        };
        World::new(
            vec![],
            vec![vec![Solid {
                shape: Shape::Sphere { radius: 0.5 },
                surface,
                turn: Mat3::IDENTITY,
                place,
            }]],
        )
    }

    #[test]
    fn sixteen_samples_see_every_point_of_every_light_once() {
        let nothing = World::new(vec![], vec![]);
        let a = pixel(&nothing, &floor(0.5), Vec3::Y, 0);
        let b = pixel(&nothing, &floor(0.5), Vec3::Y, 16);
        assert!(a.distance(b) < 1e-5, "{a} {b}");
        let lights = Lights::room();
        assert!(
            lights.shade(&nothing, &floor(0.5), Vec3::Y, 0).distance(a) > 1e-6,
            "one sample alone does not"
        );
    }

    #[test]
    fn shadows_darken_and_bounced_light_remains() {
        let open = pixel(&World::new(vec![], vec![]), &floor(0.0), Vec3::Y, 0);
        let shaded = pixel(&ball(Vec3::new(-0.7, 0.9, 0.6)), &floor(0.0), Vec3::Y, 0);
        let covered = pixel(&ball(Vec3::new(0.0, 0.501, 0.0)), &floor(0.0), Vec3::Y, 0);
        assert!(
            shaded.max_element() < 0.7 * open.min_element(),
            "{shaded} in {open}"
        );
        assert!(covered.cmpgt(Vec3::ZERO).all() && covered.max_element() < shaded.min_element());
    }

    #[test]
    fn highlights_are_seen_from_where_they_mirror_the_lamp() {
        let nothing = World::new(vec![], vec![]);
        let mirror = Vec3::new(2.6, 3.3, -2.3).normalize();
        let shine = |to_eye| {
            (pixel(&nothing, &floor(1.0), to_eye, 0) - pixel(&nothing, &floor(0.0), to_eye, 0)).x
        };
        assert!(shine(mirror) > 0.3, "{}", shine(mirror));
        assert!(shine(Vec3::new(-0.8, 0.2, 0.6).normalize()) < 0.01);
    }
}
