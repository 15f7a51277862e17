//! `export cameras`: the cameras of an image set for the programs of film and games. Writes one file.

use std::path::PathBuf;

use artifacts_schema::StoredImages;
use clap::{Args, ValueEnum};
use formats::shot::{Format, Rate, Shot, Up};
use glam::DVec3;
use serde_json::json;

use super::error::Error;
use super::whole;
use crate::terminal::output::{print, print_json, tell};

/// How the frames of a path are called.
const FRAME: &str = "frame_";

/// Options of `export cameras`.
#[derive(Args)]
pub struct CameraFile {
    /// The folder of an image set, such as that of a path (out/orbit/fly/images)
    images: PathBuf,
    /// The file to write: .usda (OpenUSD), .gltf or .glb
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// One camera that moves, or one for each view; by default the first where the views are a
    /// path's frames (frame_0000, ...)
    #[arg(long = "as", value_enum, value_name = "WHAT")]
    what: Option<What>,
    /// The number of the first frame
    #[arg(long, default_value_t = 1, value_name = "N")]
    first: u32,
    /// Frames a second: 24, 23.976 or 30000/1001
    #[arg(long, default_value_t = Rate::default(), value_name = "RATE")]
    fps: Rate,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    Path,
    Views,
}

impl CameraFile {
    /// Writes the file and says what is in it, and what is not.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let format = self.format()?;
        let shot = self.shot()?;
        let bytes = shot.to_bytes(format);
        whole::file(&self.output, |out| out.write_all(&bytes))?;
        let notes = shot.left_out(format);
        let count = shot.cameras.len();
        let up = format!("{:?}", shot.up);
        if json {
            print_json(
                &json!({"cameras": count, "moves": shot.moves, "up": up, "warnings": notes}),
            );
            return Ok(());
        }
        notes
            .iter()
            .for_each(|note| tell(&format_args!("warning: {note}")));
        let what = match shot.moves {
            true => format!("a camera of {count} frames, {} a second", shot.rate),
            false => format!("{count} cameras"),
        };
        print(&format_args!(
            "{}: {what}, +{up} upwards",
            self.output.display()
        ));
        Ok(())
    }

    fn format(&self) -> Result<Format, Error> {
        let ending = self.output.extension().and_then(|ending| ending.to_str());
        ending.and_then(Format::by_ending).ok_or_else(|| {
            Error::usage(
                format!("{} ends in no format of cameras", self.output.display()),
                "name a file that ends in .usda, .gltf or .glb",
            )
        })
    }

    fn shot(&self) -> Result<Shot, Error> {
        let refuse = |problem: String| {
            Error::usage(
                problem,
                "give the folder of an image set, with transforms.json",
            )
        };
        let images = StoredImages::open(&self.images).map_err(|error| refuse(error.to_string()))?;
        let cameras = images.cameras().to_vec();
        if cameras.is_empty() {
            return Err(refuse(format!("{} has no cameras", self.images.display())));
        }
        // Views of photos stand anywhere, and as one moving camera would jump about.
        let is_path = cameras.iter().all(|(name, _)| name.starts_with(FRAME));
        let all: Vec<_> = cameras.iter().map(|(_, camera)| *camera).collect();
        Ok(Shot {
            moves: self.what.map_or(is_path, |what| what == What::Path),
            cameras,
            rate: self.fps,
            first: self.first,
            up: up(&all),
        })
    }
}

/// The axis that is more upwards in the cameras' pictures.
pub fn up(cameras: &[formats::Camera]) -> Up {
    let up = scene::upwards(cameras);
    match up.dot(DVec3::Z) > up.dot(DVec3::Y) {
        true => Up::Z,
        false => Up::Y,
    }
}
