//! Photos that files of poses name, gathered one by one: found, looked at, and brought together
//! with their cameras. Knows no format of poses and decodes no photo.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use formats::Camera;
use image::metadata::Orientation;

use crate::SceneError;
use crate::finder::{Finder, Found};
use crate::photo_file::{self, Header};

/// Photos reduced by whole factors differ from the full size's shape by a pixel's rounding, not by
/// more.
pub(crate) const SAME_SHAPE: f64 = 0.03;

/// A photo that was found.
#[derive(Clone, Debug)]
pub(crate) struct Spotted {
    pub(crate) file: PathBuf,
    pub(crate) header: Header,
}

/// What was found so far, and what was not.
#[derive(Default)]
pub(crate) struct Gathering {
    pub(crate) finder: Finder,
    found: usize,
    /// The folder that it was looked for in, and its name there.
    missing: Vec<(PathBuf, String)>,
    not_read: Vec<(PathBuf, &'static str)>,
    /// How many photos were turned, and how many left as they are, by their EXIF orientation.
    turned: BTreeMap<u8, usize>,
    left: BTreeMap<u8, usize>,
}

impl Gathering {
    /// Looks for the photo that `named` means, seen from `folder`. One that is not there is
    /// remembered.
    pub(crate) fn find(
        &mut self,
        folder: &Path,
        named: &str,
    ) -> Result<Option<Spotted>, SceneError> {
        match self.finder.find(folder, named) {
            Found::Photo(file) => {
                self.found += 1;
                let header = photo_file::header(&file)?;
                return Ok(Some(Spotted { file, header }));
            }
            Found::NotRead(file, format) => self.not_read.push((file, format)),
            Found::Missing => self.missing.push((folder.to_owned(), named.to_owned())),
        }
        Ok(None)
    }

    /// The camera at the size of the photo's file, which may be a reduced copy, and how the file's
    /// rows are turned: as its EXIF tag says, if that alone gives the shape that the camera is for.
    pub(crate) fn fit(
        &mut self,
        camera: &Camera,
        spotted: &Spotted,
    ) -> Result<(Camera, Orientation), SceneError> {
        let Header { size, orientation } = spotted.header;
        let turned_size = spotted.header.turned_size();
        let tag = orientation.to_exif();
        // First without the tag: pose estimation takes rows as they lie in the file.
        if has_shape_of(camera, size) {
            if orientation != Orientation::NoTransforms {
                *self.left.entry(tag).or_default() += 1;
            }
            return Ok((camera.scaled(size.0, size.1), Orientation::NoTransforms));
        }
        if has_shape_of(camera, turned_size) {
            *self.turned.entry(tag).or_default() += 1;
            return Ok((camera.scaled(turned_size.0, turned_size.1), orientation));
        }
        let tag = match orientation {
            Orientation::NoTransforms => String::new(),
            _ => format!(" (and its EXIF orientation is {tag})"),
        };
        let fault = format!(
            "is {}x{}{tag}, but its camera is for {}x{}: another aspect ratio",
            size.0, size.1, camera.width, camera.height
        );
        Err(SceneError::content(&spotted.file, "the photo", fault))
    }

    /// Notes on what was gathered; an error if there is no photo at all.
    pub(crate) fn settle(self, remedy: &str) -> Result<Vec<String>, SceneError> {
        if self.found == 0 {
            // A photo that is there in the wrong format tells more than one that is missing.
            if let Some((path, format)) = self.not_read.first() {
                return Err(SceneError::not_read(path, format));
            }
            let path = self.missing.first().map(|(folder, name)| folder.join(name));
            return Err(SceneError::Missing {
                path: path.unwrap_or_default(),
                expected: "the photo",
                remedy: remedy.to_owned(),
            });
        }
        Ok(self.notes())
    }

    /// Notes on what was gathered, of photos that are known to be there.
    pub(crate) fn notes(self) -> Vec<String> {
        let count = self.found + self.missing.len() + self.not_read.len();
        let mut notes = Vec::new();
        if let Some((_, first)) = self.missing.first() {
            notes.push(format!(
                "{} of {count} photos are missing, such as {first}",
                self.missing.len(),
            ));
        }
        if let Some((first, format)) = self.not_read.first() {
            notes.push(format!(
                "{} of {count} photos are of a format that is not read, such as {} ({format}): convert them to {}",
                self.not_read.len(),
                first.display(),
                photo_file::FORMATS
            ));
        }
        for (tag, count) in self.turned {
            notes.push(format!(
                "{count} photos have the EXIF orientation {tag} and are turned by it, as their cameras are for"
            ));
        }
        for (tag, count) in self.left {
            notes.push(format!(
                "{count} photos have the EXIF orientation {tag}, which is not applied: pose estimation takes rows as they \
                 lie in the file; if it did not here, write the photos anew without the tag"
            ));
        }
        notes
    }
}

/// Whether a photo of this size shows what the camera is for, if reduced or enlarged evenly.
fn has_shape_of(camera: &Camera, size: (u32, u32)) -> bool {
    let across = f64::from(size.0) / f64::from(camera.width);
    let down = f64::from(size.1) / f64::from(camera.height);
    (across / down - 1.0).abs() <= SAME_SHAPE
}

/// Says how many of the photos that lie there have no pose, if there are any; `used` are those that
/// have one.
pub(crate) fn without_pose<'p>(
    there: &[PathBuf],
    used: impl Iterator<Item = &'p PathBuf>,
) -> Option<String> {
    // A path may lead around by way of another folder.
    let real = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let used: BTreeSet<PathBuf> = used.map(|path| real(path)).collect();
    let without: Vec<&PathBuf> = there
        .iter()
        .filter(|photo| !used.contains(&real(photo)))
        .collect();
    let first = without.first()?;
    Some(format!(
        "{} of {} photos have a pose; the others are left out, such as {}",
        there.len() - without.len(),
        there.len(),
        first.display()
    ))
}
