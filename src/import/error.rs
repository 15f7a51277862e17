//! What can go wrong while poses are found. Every message names the file or the program, and the
//! way out.

use std::path::{Path, PathBuf};

use miette::Diagnostic;

use crate::terminal::exit::{FAILED, FOUND, PIPELINE, USAGE};

/// Why there are no poses.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ImportError {
    /// No program that finds poses.
    #[error(
        "neither `colmap` nor a Python with `pycolmap` is here, and poses are found by one of them"
    )]
    #[diagnostic(help(
        "python3 -m venv poses && poses/bin/pip install pycolmap, then --python poses/bin/python; \
         or apt install colmap (older and slower)"
    ))]
    NoTool,
    /// A program that was named is none.
    #[error("{} is no {what}: {fault}", .path.display())]
    #[diagnostic(help(
        "--colmap takes COLMAP's program, --python a Python that can `import pycolmap`"
    ))]
    NotATool {
        /// The program.
        path: PathBuf,
        /// What it should be.
        what: &'static str,
        /// What it says instead.
        fault: String,
    },
    /// Nothing to find poses for.
    #[error("{} holds no photos that can be used", .path.display())]
    #[diagnostic(help(
        "a folder of JPEG, PNG or TIFF files, or a video; HEIC has to be converted first"
    ))]
    NoPhotos {
        /// The folder.
        path: PathBuf,
    },
    /// Frames of a video, and no ffmpeg.
    #[error("the frames of {} are taken out by ffmpeg, which cannot be started: {error}", .path.display())]
    #[diagnostic(help("apt install ffmpeg, or give a folder of photos"))]
    NoFfmpeg {
        /// The video.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// A program that failed.
    #[error("{what} failed ({status}): {last}")]
    #[diagnostic(help("all that it said is in {}", .log.display()))]
    Failed {
        /// What it was to do.
        what: &'static str,
        /// How it ended.
        status: String,
        /// Its last words.
        last: String,
        /// Where the others are.
        log: PathBuf,
    },
    /// Too few photos found a place.
    #[error("{registered} of {photos} photos found a pose, too few for a field")]
    #[diagnostic(help(
        "photos that overlap by two thirds, sharp, of a scene that does not move, with texture, from different \
         places (turning on the spot shows no depth); one zoom setting; --least 0.3 takes fewer. COLMAP's words are in {}",
        .log.display()
    ))]
    TooFew {
        /// How many.
        registered: usize,
        /// Of how many.
        photos: usize,
        /// What COLMAP said.
        log: PathBuf,
    },
    /// A file that cannot be read or written.
    #[error("{}: {error}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
}

impl ImportError {
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NoTool | Self::NotATool { .. } | Self::NoFfmpeg { .. } => USAGE,
            Self::NoPhotos { .. } | Self::File { .. } => PIPELINE,
            Self::Failed { .. } => FAILED,
            // COLMAP has not failed: its result was checked, and is not good enough.
            Self::TooFew { .. } => FOUND,
        }
    }

    /// A file that cannot be read or written.
    pub fn file(path: &Path, error: std::io::Error) -> Self {
        Self::File {
            path: path.to_owned(),
            error,
        }
    }
}
