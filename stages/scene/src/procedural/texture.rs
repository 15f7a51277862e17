//! What solids are made of: patterns in a solid's own coordinates. Knows nothing of shapes, places
//! or light.

use std::f32::consts::TAU;

use formats::color::srgb_to_linear;
use glam::{FloatExt, Vec2, Vec3};

use super::glyphs::Text;

/// How a point of a surface answers light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Material {
    /// Diffuse reflectance in linear light, 0 to 1.
    pub(super) color: Vec3,
    /// Strength of the highlight in 0..=1.
    pub(super) gloss: f32,
}

/// A solid texture. Colours are linear; lengths are world units.
#[derive(Clone, Debug)]
pub(super) enum Surface {
    Plain {
        color: Vec3,
        gloss: f32,
    },
    /// Courses of `size` bricks on the faces towards z.
    Brick {
        brick: Vec3,
        mortar: Vec3,
        size: Vec2,
    },
    /// Planks along x, `width` across z.
    Wood {
        light: Vec3,
        dark: Vec3,
        width: f32,
    },
    /// `count` squares around a sphere's equator.
    Checker {
        colors: [Vec3; 2],
        count: f32,
        gloss: f32,
    },
    /// Rings of `width` along y.
    Stripes {
        colors: [Vec3; 2],
        width: f32,
        gloss: f32,
    },
    /// `count` stripes that wind along a ring.
    Twist {
        colors: [Vec3; 2],
        count: f32,
    },
    /// Print on the face towards +z, bare paper elsewhere.
    Print {
        paper: Vec3,
        ink: Vec3,
        texts: Vec<Text>,
        star: Option<Star>,
    },
    /// A book lying on its side: a printed spine towards +z, leaves on the other sides, covers of
    /// `cover` thickness.
    Book {
        cloth: Vec3,
        foil: Vec3,
        title: Text,
        half: Vec3,
        cover: f32,
    },
    /// A toy block of half side `half` with the same letter in a frame on every side.
    Letter {
        paint: Vec3,
        wood: Vec3,
        letter: Text,
        half: f32,
    },
}

/// A Siemens star: `spokes` dark sectors, so ever finer towards the middle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Star {
    pub(super) middle: Vec2,
    pub(super) radius: f32,
    pub(super) spokes: f32,
}

/// The linear colour of an sRGB hex triple such as 0xff8000.
pub(super) fn hex(rgb: u32) -> Vec3 {
    let channel = |shift: u32| srgb_to_linear((rgb >> shift & 0xff) as f32 / 255.0);
    Vec3::new(channel(16), channel(8), channel(0))
}

impl Surface {
    /// The material at a point of the solid with the given outward normal, both in the solid's own
    /// coordinates.
    pub(super) fn at(&self, point: Vec3, normal: Vec3) -> Material {
        match self {
            Surface::Plain { color, gloss } => Material {
                color: *color,
                gloss: *gloss,
            },
            Surface::Brick {
                brick,
                mortar,
                size,
            } => matte(bricks(face(point, normal), *brick, *mortar, *size)),
            Surface::Wood { light, dark, width } => Material {
                color: wood(point, *light, *dark, *width),
                gloss: 0.12,
            },
            Surface::Checker {
                colors,
                count,
                gloss,
            } => {
                let turn = point.z.atan2(point.x) / TAU;
                // Rounding may bring the quotient past 1, where `asin` is NaN.
                let height = (point.y / point.length()).clamp(-1.0, 1.0).asin() / TAU;
                Material {
                    color: colors[parity(turn * count) ^ parity(height * count)],
                    gloss: *gloss,
                }
            }
            Surface::Stripes {
                colors,
                width,
                gloss,
            } => Material {
                // A period has two stripes.
                color: colors[parity(point.y / width / 2.0)],
                gloss: *gloss,
            },
            Surface::Twist { colors, count } => {
                let around = point.z.atan2(point.x) / TAU;
                let ring = Vec2::new(point.x, point.z).normalize_or_zero();
                let outward = normal.x * ring.x + normal.z * ring.y;
                Material {
                    // Around the ring and around its tube at once, which makes stripes wind.
                    color: colors[parity(around * count + normal.y.atan2(outward) / TAU)],
                    gloss: 0.5,
                }
            }
            Surface::Print {
                paper,
                ink,
                texts,
                star,
            } => {
                let at = Vec2::new(point.x, point.y);
                let printed = texts.iter().any(|text| text.inks(at))
                    || star.is_some_and(|star| star.inks(at));
                matte(if normal.z > 0.5 && printed {
                    *ink
                } else {
                    *paper
                })
            }
            Surface::Book {
                cloth,
                foil,
                title,
                half,
                cover,
            } => {
                let leaves =
                    point.y.abs() < half.y - cover && normal.y.abs() < 0.5 && normal.z < 0.5;
                let foiled = normal.z > 0.5
                    && (title.inks(Vec2::new(point.x, point.y)) || bands(point.x, half.x));
                let leaf = hex(0xe9e0c8)
                    * if parity(point.y / 0.012) == 0 {
                        1.0
                    } else {
                        0.72
                    };
                matte(if leaves {
                    leaf
                } else if foiled {
                    *foil
                } else {
                    *cloth
                })
            }
            Surface::Letter {
                paint,
                wood,
                letter,
                half,
            } => {
                let at = face(point, normal);
                let rim = at.abs().max_element() / half;
                let painted = letter.inks(at) || (0.76..0.88).contains(&rim);
                Material {
                    color: if painted {
                        *paint
                    } else {
                        grain(point * 3.0, *wood)
                    },
                    gloss: 0.15,
                }
            }
        }
    }
}

impl Star {
    fn inks(&self, at: Vec2) -> bool {
        let arm = at - self.middle;
        arm.length() < self.radius && parity(arm.to_angle() / TAU * self.spokes) == 0
    }
}

fn matte(color: Vec3) -> Material {
    Material { color, gloss: 0.0 }
}

/// 0 or 1 by halves: which half of its period `x` is in.
fn parity(x: f32) -> usize {
    usize::from(x - x.floor() >= 0.5)
}

/// Coordinates on a block's face: x to the right and y up as seen from outside, on top as seen from
/// the front.
fn face(point: Vec3, normal: Vec3) -> Vec2 {
    let across = normal.abs();
    if across.y > across.x.max(across.z) {
        Vec2::new(point.x, -point.z * normal.y.signum())
    } else if across.x > across.z {
        Vec2::new(-point.z * normal.x.signum(), point.y)
    } else {
        Vec2::new(point.x * normal.z.signum(), point.y)
    }
}

/// Two gilded bands near the ends of a spine.
fn bands(x: f32, half_width: f32) -> bool {
    [0.80, 0.87]
        .iter()
        .any(|at| (x.abs() / half_width - at).abs() < 0.016)
}

fn bricks(at: Vec2, brick: Vec3, mortar: Vec3, size: Vec2) -> Vec3 {
    const JOINT: f32 = 0.013;
    let course = (at.y / size.y).floor();
    let along = at.x / size.x + 0.5 * parity(course / 2.0) as f32;
    let inside = Vec2::new(along.fract_gl() * size.x, at.y - course * size.y);
    let rough = noise(at * 90.0);
    if inside.x < JOINT || inside.y < JOINT {
        return mortar * (0.86 + 0.2 * rough);
    }
    let own = lattice(along.floor() as i32, course as i32);
    let hue = Vec3::new(
        1.0,
        0.9 + 0.2 * lattice(course as i32, along.floor() as i32),
        0.95,
    );
    brick * hue * (0.66 + 0.5 * own) * (0.82 + 0.36 * noise(at * 45.0) * rough.lerp(1.0, 0.4))
}

fn wood(point: Vec3, light: Vec3, dark: Vec3, width: f32) -> Vec3 {
    const SEAM: f32 = 0.005;
    let plank = (point.z / width).floor();
    // Each plank begins elsewhere in the same noise.
    let shift = 17.0 * lattice(plank as i32, 5);
    let across = point.z - plank * width;
    if across < SEAM {
        return dark * 0.25;
    }
    let waver = 0.05 * noise(Vec2::new(point.x * 1.7 + shift, across * 9.0));
    let ring = ((across + waver) * 30.0 + shift).sin() * 0.5 + 0.5;
    let fibre = noise(Vec2::new(point.x * 9.0 + shift, point.z * 210.0));
    let tint = 0.85 + 0.3 * lattice(plank as i32, 11);
    light.lerp(dark, 0.55 * ring * ring + 0.4 * fibre * fibre) * tint
}

/// Faint fibres along x through a light wood.
fn grain(point: Vec3, color: Vec3) -> Vec3 {
    color * (0.86 + 0.14 * noise(Vec2::new(point.x * 4.0, (point.y + point.z) * 50.0)))
}

/// Smooth value noise in 0..=1 with features of about one unit.
fn noise(at: Vec2) -> f32 {
    let cell = at.floor();
    let f = at - cell;
    // Smooth at the lattice, so that no creases show.
    let f = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let x = cell.x as i32;
    let y = cell.y as i32;
    // Wrapping, since the cast saturates for points far away.
    let low = lattice(x, y).lerp(lattice(x.wrapping_add(1), y), f.x);
    let high =
        lattice(x, y.wrapping_add(1)).lerp(lattice(x.wrapping_add(1), y.wrapping_add(1)), f.x);
    low.lerp(high, f.y)
}

/// A fixed number in 0..1 for each point of the integer lattice: part of a pattern, not of any
/// random stream.
fn lattice(x: i32, y: i32) -> f32 {
    // A hash in whole numbers: the same pictures on every machine.
    let mut bits = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
    bits = (bits ^ bits >> 15).wrapping_mul(0x2C1B_3C6D);
    bits = (bits ^ bits >> 12).wrapping_mul(0x297A_2D39);
    // 24 bits, as many as an f32 holds exactly.
    ((bits ^ bits >> 15) >> 8) as f32 / (1 << 24) as f32
}
