//! `export video`: an image set as a moving picture: MP4 or WebM by the `ffmpeg` on the PATH, or an
//! animated WebP without it. Writes one file.

use std::path::PathBuf;

use artifacts_schema::{ImageSet, Picture};
use clap::{Args, ValueEnum};
use formats::shot::Rate;
use serde_json::json;
use stages::kinds::film::Show;

use super::error::Error;
use super::{artifact, whole};
use crate::export::ffmpeg::{Codec, Ffmpeg, FfmpegError};
use crate::export::webp;
use crate::terminal::output::{print, print_json, tell};

/// Options of `export video`.
#[derive(Args)]
pub struct Video {
    /// The images, shown in the order of their names: the folder of an image set, such as that of a
    /// path (out/orbit/fly/images)
    images: PathBuf,
    /// The file to write: .mp4 or .webm, for which an ffmpeg must be on the PATH, or .webp, which
    /// loses nothing and needs none
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Frames a second: 24, 23.976 or 30000/1001
    #[arg(long, default_value_t = Rate::default(), value_name = "RATE")]
    fps: Rate,
    /// How much may be lost, from 0 (nothing) on: the codec's CRF, by default 16 in an MP4 and 24
    /// in a WebM
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=51))]
    crf: Option<u32>,
    /// What of the images is shown
    #[arg(long, value_enum, default_value_t = What::Color)]
    show: What,
    /// The grey behind transparent images, sRGB from 0 to 1
    #[arg(long, default_value_t = 1.0, value_name = "GREY")]
    background: f32,
}

#[derive(Clone, Copy, ValueEnum)]
enum What {
    Color,
    Depth,
    Opacity,
}

/// What the file is.
enum Format {
    Webp,
    Film(Codec),
}

impl Video {
    /// Writes the file and says what is in it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let format = self.format()?;
        if !(0.0..=1.0).contains(&self.background) {
            let message = format!("--background is {}", self.background);
            return Err(Error::usage(message, "it must be 0 to 1"));
        }
        let images = artifact::images(&self.images)?;
        let pictures = self.pictures(&images)?;
        match format {
            Format::Webp => {
                let bytes = webp::animation(&pictures, self.fps)
                    .map_err(|error| whole::refused(&self.output, &error))?;
                whole::file(&self.output, |out| out.write_all(&bytes))?;
                self.report(&pictures, None, json);
            }
            Format::Film(codec) => {
                self.film(codec, &pictures)?;
                // All pictures are of one size, so the first speaks for all.
                self.report(&pictures, cropped(&pictures[0]), json);
            }
        }
        Ok(())
    }

    fn report(&self, pictures: &[Picture], note: Option<String>, json: bool) {
        let count = pictures.len();
        let [width, height] = [pictures[0].width, pictures[0].height];
        if json {
            let notes: Vec<String> = note.into_iter().collect();
            print_json(&json!({
                "frames": count, "width": width, "height": height, "warnings": notes,
            }));
            return;
        }
        if let Some(note) = note {
            tell(&format_args!("warning: {note}"));
        }
        print(&format_args!(
            "{}: {count} frames of {width}x{height}, {} a second",
            self.output.display(),
            self.fps
        ));
    }

    fn format(&self) -> Result<Format, Error> {
        let ending = self.output.extension().and_then(|ending| ending.to_str());
        match ending.map(str::to_ascii_lowercase).as_deref() {
            Some("webp") => Ok(Format::Webp),
            Some("mp4") => Ok(Format::Film(Codec::H264)),
            Some("webm") => Ok(Format::Film(Codec::Vp9)),
            _ => Err(Error::usage(
                format!(
                    "{} ends in no format of moving pictures",
                    self.output.display()
                ),
                "name a file that ends in .mp4, .webm or .webp; `Film` writes a GIF",
            )),
        }
    }

    /// What is shown: at least one picture, all of one size.
    fn pictures(&self, images: &ImageSet) -> Result<Vec<Picture>, Error> {
        let show = match self.show {
            What::Color => Show::Color,
            What::Depth => Show::Depth,
            What::Opacity => Show::Opacity,
        };
        let shown = show.pictures(images, self.background).images;
        let refuse = |problem: String| {
            let message = format!("{}: {problem}", self.images.display());
            Error::usage(message, "give an image set whose images are of one size")
        };
        let mut pictures = shown.iter();
        let Some((_, first)) = pictures.next() else {
            return Err(refuse(format!("no image has any {}", show.port().name)));
        };
        let size = |picture: &Picture| (picture.width, picture.height);
        if let Some((name, other)) = pictures.find(|(_, other)| size(other) != size(first)) {
            return Err(refuse(format!(
                "{name} is {}x{}, and the first image {}x{}",
                other.width, other.height, first.width, first.height
            )));
        }
        Ok(shown.into_values().collect())
    }

    fn film(&self, codec: Codec, pictures: &[Picture]) -> Result<(), Error> {
        let ffmpeg = Ffmpeg {
            codec,
            rate: self.fps,
            // One number means different losses to different codecs, so each has a default of its
            // own.
            crf: self.crf.unwrap_or(codec.usual_crf()),
        };
        whole::by_another(&self.output, |path| {
            ffmpeg.write(pictures, path).map_err(|error| match error {
                FfmpegError::Missing => Error::usage(
                    error.to_string(),
                    "install it (`apt install ffmpeg`, `brew install ffmpeg`), or write an animated WebP, which needs none: -o FILE.webp",
                ),
                _ => Error::usage(error.to_string(), "an animated WebP needs no ffmpeg: -o FILE.webp"),
            })
        })
    }
}

/// Both codecs halve colours' resolution, for which sides must be even.
fn cropped(picture: &Picture) -> Option<String> {
    let [width, height] = [picture.width, picture.height].map(|side| side - side % 2);
    let is_odd = [width, height] != [picture.width, picture.height];
    is_odd.then(|| {
        format!("sides must be even: the last column or row is cut off, and {width}x{height} pixels are left")
    })
}
