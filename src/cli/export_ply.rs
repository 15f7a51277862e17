//! `export ply`: the surface of a field for other programs. Writes one file.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use stages::{ply, surface};

use super::error::Error;
use super::{artifact, whole};
use crate::terminal::output::{print, print_json};

/// Options of `export ply`.
#[derive(Args)]
pub struct Ply {
    /// A field: field.safetensors, or the folder that it is in (out/i3ds/main/fit/field)
    field: PathBuf,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Cells along the longest side of the scene box
    #[arg(long, default_value_t = surface::USUAL_RESOLUTION, value_parser = clap::value_parser!(u32).range(8..=768))]
    resolution: u32,
    /// The density of the surface, per scene unit; by default that which halves light within 1/100
    /// of the box
    #[arg(long, value_name = "DENSITY")]
    level: Option<f32>,
    /// Only the points, without faces
    #[arg(long)]
    points: bool,
}

impl Ply {
    /// Writes the file and says what is in it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let field = artifact::field(&self.field)?;
        let level = self.level.unwrap_or_else(|| surface::usual_level(&field));
        // Negated as a whole, so that NaN, which no comparison holds for, is refused too.
        if !(level > 0.0 && level.is_finite()) {
            return Err(Error::usage(
                format!("--level is {level}"),
                "it must be above 0",
            ));
        }
        let surface = surface::surface(&field, self.resolution, level);
        whole::file(&self.output, |mut out| {
            ply::write(&surface, self.points, &mut out)
        })?;
        let vertices = surface.vertices.len();
        let triangles = if self.points {
            0
        } else {
            surface.triangles.len()
        };
        match json {
            true => {
                print_json(&json!({"vertices": vertices, "triangles": triangles, "level": level}))
            }
            false => print(&format_args!(
                "{}: {vertices} points, {triangles} triangles, at a density of {level:.3} per scene unit",
                self.output.display()
            )),
        }
        Ok(())
    }
}
