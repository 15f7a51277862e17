//! `export exr`: an image set as a sequence of OpenEXR frames for compositors. Writes one folder.

use std::path::{Path, PathBuf};

use artifacts_schema::{ImageSet, View};
use clap::{Args, ValueEnum};
use formats::openexr::{Frame, FrameOptions, Packing};
use formats::shot::Rate;
use rayon::prelude::*;
use serde_json::json;

use super::error::Error;
use super::numbered::Pattern;
use super::{artifact, whole};
use crate::content;
use crate::terminal::output::{print, print_json, tell};

/// Options of `export exr`.
#[derive(Args)]
pub struct Exr {
    /// The images: the folder of an image set, such as that of a path (out/orbit/fly/images)
    images: PathBuf,
    /// The files to write, with a # for each digit of their numbers, in a folder that is not there
    /// yet: fly/fly.####.exr
    #[arg(short, long, value_name = "PATTERN")]
    output: PathBuf,
    /// The number of the first frame
    #[arg(long, default_value_t = 1, value_name = "N")]
    first: u32,
    /// Numbers of 16 or of 32 bits; depths always have 32
    #[arg(long, value_enum, default_value_t = Numbers::Half)]
    numbers: Numbers,
    /// How pixels are packed; dwaa and dwab lose a little, all others nothing
    #[arg(long, value_enum, default_value_t = Compression::Zip)]
    compression: Compression,
    /// Depth and normals as parts of their own, not as layers beside the colours
    #[arg(long)]
    parts: bool,
    /// Without normals, which are found from depths
    #[arg(long)]
    no_normals: bool,
    /// Frames a second, for the header: 24, 23.976 or 30000/1001
    #[arg(long, default_value_t = Rate::default(), value_name = "RATE")]
    fps: Rate,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Numbers {
    Half,
    Float,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Compression {
    None,
    Rle,
    Zips,
    Zip,
    Piz,
    Dwaa,
    Dwab,
}

impl Compression {
    fn packing(self) -> Packing {
        match self {
            Self::None => Packing::None,
            Self::Rle => Packing::Rle,
            Self::Zips => Packing::Zips,
            Self::Zip => Packing::Zip,
            Self::Piz => Packing::Piz,
            Self::Dwaa => Packing::Dwaa,
            Self::Dwab => Packing::Dwab,
        }
    }
}

impl Exr {
    /// Writes the frames and says what is in them.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let pattern = Pattern::of(&self.output)?;
        let images = artifact::images(&self.images)?;
        if images.views.is_empty() {
            let message = format!("{} has no images", self.images.display());
            return Err(Error::usage(message, "give an image set with some"));
        }
        whole::folder(&pattern.folder, |folder| {
            std::fs::create_dir(folder).map_err(|error| whole::refused(folder, &error))?;
            self.write(folder, &pattern, &images)
        })?;
        self.report(&images, json);
        Ok(())
    }

    fn write(&self, folder: &Path, pattern: &Pattern, images: &ImageSet) -> Result<(), Error> {
        let about = self.about();
        let write = |(i, view): (usize, &View)| {
            // In 64 bits: `--first` may be the largest number of 32 bits already.
            let number = u64::from(self.first) + i as u64;
            let path = folder.join(pattern.file(number));
            let bytes = self
                .frame(view, &about)
                .map_err(|error| whole::refused(&self.output, &error))?;
            std::fs::write(&path, bytes).map_err(|error| whole::refused(&self.output, &error))
        };
        // Of several failures the first is named, however many threads there are.
        let written: Vec<Result<(), Error>> =
            images.views.par_iter().enumerate().map(write).collect();
        written.into_iter().collect()
    }

    fn frame(
        &self,
        view: &View,
        about: &serde_json::Value,
    ) -> Result<Vec<u8>, formats::openexr::ExrError> {
        let normals = view
            .depth
            .as_ref()
            .filter(|_| !self.no_normals)
            .map(|depth| {
                // Where nothing covers a pixel its depth is no surface, and has no normal.
                let coverage: Vec<f32> =
                    (0..depth.len()).map(|i| view.pixels.coverage(i)).collect();
                splat::normals(&view.camera, depth, &coverage)
            });
        let mut about = about.clone();
        // OpenEXR has no attribute for a lens, so it stands in the text about the frame.
        if !view.camera.distortion.is_none() {
            about["distortion"] = json!(view.camera.distortion);
        }
        Frame {
            camera: &view.camera,
            pixels: &view.pixels,
            depth: view.depth.as_deref(),
            normals: normals.as_deref(),
            mask: view.mask.as_deref(),
            name: &view.name,
            about: &about.to_string(),
        }
        .to_bytes(&self.options())
    }

    fn options(&self) -> FrameOptions {
        FrameOptions {
            parts: self.parts,
            half: self.numbers == Numbers::Half,
            packing: self.compression.packing(),
            rate: Some(self.fps),
        }
    }

    /// Where the images come from, as their own files tell.
    fn about(&self) -> serde_json::Value {
        let provenance = content::provenance(&self.images.join("transforms.json"));
        json!(provenance.unwrap_or_default())
    }

    fn report(&self, images: &ImageSet, json: bool) {
        let views = &images.views;
        let last = u64::from(self.first) + views.len() as u64 - 1;
        let notes = notes(images);
        if json {
            print_json(&json!({
                "frames": views.len(), "first": self.first, "last": last, "layers": layers(images, !self.no_normals), "warnings": notes,
            }));
            return;
        }
        notes
            .iter()
            .for_each(|note| tell(&format_args!("warning: {note}")));
        print(&format_args!(
            "{}: frames {} to {last} ({}), {}",
            self.output.display(),
            self.first,
            layers(images, !self.no_normals).join(", "),
            match self.parts {
                true => "in parts",
                false => "in layers",
            }
        ));
    }
}

/// What the frames hold, by the names of channels in layers.
fn layers(images: &ImageSet, normals: bool) -> Vec<&'static str> {
    let any = |has: &dyn Fn(&View) -> bool| images.views.iter().any(has);
    // What any frame has is named: frames of one set need not hold the same.
    let depth = any(&|view| view.depth.is_some());
    let all = [
        ("RGB", true),
        ("A", any(&|view| view.pixels.alpha.is_some())),
        ("mask", any(&|view| view.mask.is_some())),
        ("depth.Z", depth),
        ("N.XYZ", depth && normals),
    ];
    let there = all.into_iter().filter(|(_, is_there)| *is_there);
    there.map(|(name, _)| name).collect()
}

/// What frames do not hold.
fn notes(images: &ImageSet) -> Vec<String> {
    let all = images.views.len();
    let count = |is: &dyn Fn(&View) -> bool| images.views.iter().filter(|view| is(view)).count();
    let bent = count(&|view| !view.camera.distortion.is_none());
    let flat = count(&|view| view.depth.is_none());
    let mut notes = Vec::new();
    if bent > 0 {
        notes.push(format!(
            "{bent} of {all} images show what a lens bends, for which OpenEXR has no attribute: it stands in `srnerf`"
        ));
    }
    if flat > 0 {
        notes.push(format!(
            "{flat} of {all} images have no depth, and so no depth.Z and N; those of `Render` have it"
        ));
    }
    notes
}
