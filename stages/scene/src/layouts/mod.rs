//! Scenes in the layouts of other programs that train on them. Knows nothing of where a scene comes
//! from.
//!
//! All layouts have their pictures in `images/`, under names that are different for all, and hold
//! the scene's own coordinates. What one cannot hold it refuses, or says so.

mod colmap;
mod frames;
mod lens;
mod shot;

use std::path::{Path, PathBuf};

use formats::{Bounds, rows};
use glam::DMat4;

use crate::{Photo, SceneError};
use shot::{Masks, Shot};

/// A program, by the layout that it reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `transforms.json` with lists of names for training and testing.
    Nerfstudio,
    /// `transforms_train.json` and `transforms_test.json`.
    Brush,
    /// A COLMAP reconstruction in text beside `images/`.
    Colmap,
    /// `transforms.json`, and `test/transforms.json` for testing.
    InstantNgp,
}

/// A scene with its photos, to be written in a layout.
#[derive(Clone, Copy, Debug)]
pub struct Capture<'c> {
    /// What is trained on.
    pub train: Part<'c>,
    /// What is held out.
    pub test: Part<'c>,
    /// The scene box, in the scene's coordinates.
    pub bounds: Bounds,
    /// Takes the scene's coordinates to those of the files that it was read from.
    pub to_source: Option<DMat4>,
    /// Points of its surface, if any are known.
    pub points: &'c [Point],
}

/// Photos with the files that they come from.
#[derive(Clone, Copy, Debug)]
pub struct Part<'p> {
    /// Photos with their cameras, decoded.
    pub photos: &'p [Photo],
    /// The folder with their EXR files, scene-linear and premultiplied, if these are wanted instead
    /// of PNGs.
    pub exr: Option<&'p Path>,
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Where it is, in the scene's coordinates.
    pub position: [f32; 3],
    /// Its colour, red, green and blue, sRGB-encoded.
    pub color: [u8; 3],
}

/// Why a scene cannot be written in a layout.
#[derive(Debug, thiserror::Error)]
pub enum LayoutError {
    /// The layout cannot hold it.
    #[error("{what}, which {layout} cannot hold")]
    Unheld {
        /// What it cannot hold.
        what: String,
        /// The program whose layout it is.
        layout: &'static str,
        /// How the user can mend it.
        remedy: &'static str,
    },
    /// The file system says no.
    #[error("{path}: cannot be written: {source}", path = path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture that cannot be encoded.
    #[error(transparent)]
    Picture(#[from] SceneError),
}

impl Layout {
    /// What the program is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nerfstudio => "nerfstudio",
            Self::Brush => "brush",
            Self::Colmap => "COLMAP's layout",
            Self::InstantNgp => "instant-ngp",
        }
    }

    /// The file in which the program looks for a cloud of points as PLY, if it does.
    pub fn points_file(self) -> Option<&'static str> {
        match self {
            Self::Nerfstudio => Some("points.ply"),
            Self::Brush => Some("init.ply"),
            Self::Colmap | Self::InstantNgp => None,
        }
    }

    /// Writes a scene into a folder, which is created, and says what was left out. The file of
    /// points is not written: it is whoever has the points who writes PLY.
    ///
    /// # Errors
    /// If the layout cannot hold the scene, or the file system says no.
    pub fn write(self, folder: &Path, capture: &Capture) -> Result<Vec<String>, LayoutError> {
        self.check_pictures(capture)?;
        let shots = shot::shots(capture);
        let masks = self.masks(&shots);
        // All texts before the first file: what a layout cannot hold must leave nothing behind.
        let mut text = match self {
            Self::Colmap => colmap::files(&shots, capture)?,
            _ => frames::files(self, &shots, capture, masks)?,
        };
        // nerfstudio has a field for it (`applied_transform`), but moves the points by it as well.
        text.extend(
            capture
                .to_source
                .map(|matrix| ("to_source.txt", lines(&matrix))),
        );
        text.iter().try_for_each(|(name, text)| {
            let path = folder.join(name);
            create(path.parent().unwrap_or(folder))?;
            std::fs::write(&path, text).map_err(|source| LayoutError::Write { path, source })
        })?;
        create(&folder.join(shot::IMAGES))?;
        shots
            .iter()
            .try_for_each(|shot| shot.write(folder, masks))?;
        Ok(self.notes(capture, &shots))
    }

    fn check_pictures(self, capture: &Capture) -> Result<(), LayoutError> {
        let is_exr = capture.train.exr.or(capture.test.exr).is_some();
        // Of these programs only instant-ngp reads EXR files.
        if is_exr && self != Self::InstantNgp {
            return Err(LayoutError::Unheld {
                what: "the pictures are to be EXR files".to_owned(),
                layout: self.name(),
                remedy: "leave out --images exr, or export for instant-ngp",
            });
        }
        Ok(())
    }

    /// Where masks go, if there are any that the program reads.
    fn masks(self, shots: &[Shot]) -> Option<Masks> {
        let masked = shots.iter().any(|shot| shot.photo.mask.is_some());
        let masks = match self {
            Self::Nerfstudio => Masks::All,
            Self::Brush => Masks::Some,
            Self::Colmap => Masks::WithEnding,
            Self::InstantNgp if shots.iter().any(|shot| shot.exr.is_some()) => return None,
            Self::InstantNgp => Masks::Dynamic,
        };
        masked.then_some(masks)
    }

    fn notes(self, capture: &Capture, shots: &[Shot]) -> Vec<String> {
        let mut notes = Vec::new();
        let masked = shots.iter().any(|shot| shot.photo.mask.is_some());
        if masked && self.masks(shots).is_none() {
            notes.push("the masks are left out: instant-ngp reads them beside PNGs alone".into());
        }
        match (self, capture.points.is_empty()) {
            (Self::InstantNgp, true) => {}
            (Self::InstantNgp, false) => {
                notes.push("the points are left out: instant-ngp begins without".into());
            }
            (_, true) => notes.push(
                "there are no points to begin with: give a field by --points for those of its surface"
                    .into(),
            ),
            (_, false) => {}
        }
        if self == Self::Colmap && !capture.test.photos.is_empty() {
            notes.push(
                "sparse/0/test.txt names the test images; programs that do not read it hold out others"
                    .into(),
            );
        }
        notes
    }
}

/// The rows of a matrix.
fn lines(matrix: &DMat4) -> String {
    let row = |[a, b, c, d]: [f64; 4]| format!("{a} {b} {c} {d}\n");
    rows::of(matrix).map(row).concat()
}

fn create(folder: &Path) -> Result<(), LayoutError> {
    std::fs::create_dir_all(folder).map_err(|source| LayoutError::Write {
        path: folder.to_owned(),
        source,
    })
}
