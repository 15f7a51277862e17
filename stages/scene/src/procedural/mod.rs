//! Worlds that the program draws itself, traced analytically at any resolution, so that the
//! high-resolution truth is really known.
//!
//! `table`, `room` and `sculpture` say what stands where, `solids` what they share, `texture` and
//! `glyphs` what it is made of, `shape` and `world` where rays meet it, `light` how bright it is,
//! `render` what a pixel is; `still_life` and `object` say from where it is seen.

mod glyphs;
mod light;
mod object;
mod render;
mod room;
mod sculpture;
mod shape;
mod solids;
mod still_life;
mod table;
mod texture;
mod world;

use crate::Photo;
use formats::{Bounds, Camera};
use light::Lights;
use render::{Picture, Seen, render};
use world::World;

pub use object::{object, object_tests};
pub use still_life::still_life;

/// Room between the outermost surface that any ray meets and near, far and the box.
const MARGIN: f32 = 0.02;

/// Photos, all with the same near and far, and the box of all that they show.
struct Photographed {
    photos: Vec<Photo>,
    bounds: Bounds,
}

/// Takes a photo with each named camera; near, far and the box lie close around all surfaces that
/// are seen. Photos in which rays leave the world have alpha.
fn photograph(
    world: &World,
    lights: &Lights,
    cameras: Vec<(String, Camera)>,
    samples: u32,
) -> Photographed {
    // One after the other: `render` itself keeps all threads busy.
    let pictures: Vec<Picture> = cameras
        .iter()
        .map(|(_, camera)| render(world, lights, camera, samples))
        .collect();
    let seen = pictures
        .iter()
        .map(|picture| picture.seen)
        .fold(Seen::NOTHING, Seen::and);
    // Surfaces are seen at sample points only; others may lie a little outside.
    let [near, far] = [
        seen.depth[0] * (1.0 - MARGIN),
        seen.depth[1] * (1.0 + MARGIN),
    ]
    .map(f64::from);
    let photo = |((name, camera), picture): ((String, Camera), Picture)| Photo {
        name,
        camera: Camera {
            near,
            far,
            ..camera
        },
        pixels: picture.pixels(),
        mask: None,
    };
    let margin = MARGIN * (seen.high - seen.low);
    Photographed {
        photos: cameras.into_iter().zip(pictures).map(photo).collect(),
        bounds: [seen.low - margin, seen.high + margin].map(|corner| corner.as_dvec3().to_array()),
    }
}
