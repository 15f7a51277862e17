//! Cameras as OpenUSD's text: `UsdGeomCamera` with apertures, their offsets and focal length. Numbers
//! are written so that they are read back as they were: poses in double precision, lenses in single.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::{Shot, Up};
use crate::Camera;

/// The width of the film, in USD's tenths of a scene unit: 36 mm where a unit is a centimetre. Only
/// its ratio to the focal length shows in pictures.
const FILM: f64 = 36.0;

pub fn text(shot: &Shot) -> String {
    let mut text = head(shot);
    text.push_str("def Xform \"cameras\"\n{\n");
    match shot.moves {
        true => {
            let frames: Vec<&Camera> = shot.cameras.iter().map(|(_, camera)| camera).collect();
            camera(&mut text, "camera", "camera", &frames, shot.first);
        }
        false => {
            let mut taken = BTreeSet::new();
            for (name, view) in &shot.cameras {
                camera(
                    &mut text,
                    &identifier(name, &mut taken),
                    name,
                    &[view],
                    shot.first,
                );
            }
        }
    }
    text.push_str("}\n");
    text
}

fn head(shot: &Shot) -> String {
    let up = match shot.up {
        Up::Y => "Y",
        Up::Z => "Z",
    };
    let mut text = String::from("#usda 1.0\n(\n    defaultPrim = \"cameras\"\n");
    if shot.moves {
        let rate = shot.rate.per_second();
        // In 64 bits: the first frame may be near the largest number.
        let last = u64::from(shot.first) + shot.cameras.len() as u64 - 1;
        let _ = write!(
            text,
            "    endTimeCode = {last}\n    framesPerSecond = {rate}\n    startTimeCode = {}\n    timeCodesPerSecond = {rate}\n",
            shot.first
        );
    }
    let _ = write!(text, "    upAxis = \"{up}\"\n)\n\n");
    text
}

/// One camera of as many frames, from the first on.
fn camera(text: &mut String, prim: &str, name: &str, frames: &[&Camera], first: u32) {
    // USD's texts are quoted, and a backslash escapes.
    let name = name.replace('\\', "\\\\").replace('"', "\\\"");
    let _ = write!(
        text,
        "    def Camera \"{prim}\" (\n        displayName = \"{name}\"\n    )\n    {{\n"
    );
    let mut value = |what: &str, of: &dyn Fn(&Camera) -> String| {
        attribute(
            text,
            what,
            frames.iter().map(|camera| of(camera)).collect(),
            first,
        );
    };
    let single = |number: f64| (number as f32).to_string();
    value("float2 clippingRange", &|c| {
        format!("({}, {})", c.near as f32, c.far as f32)
    });
    value("float focalLength", &|c| single(focal(c)));
    value("float horizontalAperture", &|_| single(FILM));
    // Of the film, in its millimetres: a principal point beside the middle is held so.
    value("float horizontalApertureOffset", &|c| {
        single((f64::from(c.width) / 2.0 - c.cx) / c.fl_x * focal(c))
    });
    value("float verticalAperture", &|c| {
        single(f64::from(c.height) / c.fl_y * focal(c))
    });
    value("float verticalApertureOffset", &|c| {
        single((c.cy - f64::from(c.height) / 2.0) / c.fl_y * focal(c))
    });
    // USD's cameras have no resolution of their own.
    value("custom int2 srnerf:resolution", &|c| {
        format!("({}, {})", c.width, c.height)
    });
    value("matrix4d xformOp:transform", &matrix);
    text.push_str("        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }\n");
}

/// A value that stands once where it is the same in all frames.
fn attribute(text: &mut String, what: &str, values: Vec<String>, first: u32) {
    let same = values.windows(2).all(|pair| pair[0] == pair[1]);
    match values.first() {
        Some(value) if same => {
            let _ = writeln!(text, "        {what} = {value}");
        }
        _ => {
            let _ = writeln!(text, "        {what}.timeSamples = {{");
            for (frame, value) in (u64::from(first)..).zip(values) {
                let _ = writeln!(text, "            {frame}: {value},");
            }
            text.push_str("        }\n");
        }
    }
}

fn focal(camera: &Camera) -> f64 {
    FILM * camera.fl_x / f64::from(camera.width)
}

/// USD multiplies row vectors from the left, so its rows are our columns.
fn matrix(camera: &Camera) -> String {
    // USD multiplies row vectors: its rows are our columns.
    let columns = camera.camera_to_world.to_cols_array_2d();
    let rows = columns.map(|[x, y, z, w]| format!("({x}, {y}, {z}, {w})"));
    format!("( {} )", rows.join(", "))
}

/// A view's name as USD may call a prim: letters, digits and underscores, no digit first, each once.
fn identifier(name: &str, taken: &mut BTreeSet<String>) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut prim: String = name.chars().map(plain).collect();
    if prim.is_empty() || prim.starts_with(|c: char| c.is_ascii_digit()) {
        prim.insert(0, '_');
    }
    // Different names may be alike once their signs are replaced.
    while !taken.insert(prim.clone()) {
        prim.push('_');
    }
    prim
}
