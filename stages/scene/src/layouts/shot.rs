//! A photo on its way into a layout: its name among all others, its picture and its mask. Knows no
//! cameras.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{Capture, LayoutError, Part, create};
use crate::finder::DYNAMIC_MASK;
use crate::{Photo, picture};

/// The folder of pictures.
pub(super) const IMAGES: &str = "images";
/// The folder of masks.
const MASKS: &str = "masks";

/// Where masks lie and what is white in them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Masks {
    /// `masks/NAME.png` for every photo: who names one names all. White counts.
    All,
    /// `masks/NAME.png` for photos that have one. White counts.
    Some,
    /// `masks/NAME.ENDING.png`, the photo's ending before the mask's own, for photos that have one.
    /// White counts.
    WithEnding,
    /// `dynamic_mask_NAME.png` beside the photo. White does not count.
    Dynamic,
}

/// A photo of a scene.
pub(super) struct Shot<'c> {
    /// Its name without ending, different for all.
    pub(super) name: String,
    pub(super) photo: &'c Photo,
    /// Its EXR file, if that is taken.
    pub(super) exr: Option<PathBuf>,
    pub(super) is_test: bool,
}

impl Shot<'_> {
    /// The name of its file in the folder of pictures.
    pub(super) fn file(&self) -> String {
        let ending = if self.exr.is_some() { "exr" } else { "png" };
        format!("{}.{ending}", self.name)
    }

    /// The path of its picture.
    pub(super) fn path(&self) -> String {
        format!("{IMAGES}/{}", self.file())
    }

    /// The path of its mask, if it has one there.
    pub(super) fn mask_path(&self, masks: Masks) -> Option<String> {
        let name = &self.name;
        let path = match masks {
            Masks::All | Masks::Some => format!("{MASKS}/{name}.png"),
            Masks::WithEnding => format!("{MASKS}/{}.png", self.file()),
            Masks::Dynamic => format!("{IMAGES}/{DYNAMIC_MASK}{name}.png"),
        };
        (masks == Masks::All || self.photo.mask.is_some()).then_some(path)
    }

    /// Writes its picture, and its mask.
    pub(super) fn write(&self, folder: &Path, masks: Option<Masks>) -> Result<(), LayoutError> {
        let path = folder.join(self.path());
        match &self.exr {
            None => picture::write(&path, self.photo)?,
            Some(file) => {
                std::fs::copy(file, &path).map_err(|source| LayoutError::Write { path, source })?;
            }
        }
        match masks {
            None => Ok(()),
            Some(masks) => self.write_mask(folder, masks),
        }
    }

    fn write_mask(&self, folder: &Path, masks: Masks) -> Result<(), LayoutError> {
        let Some(path) = self.mask_path(masks) else {
            return Ok(());
        };
        let path = folder.join(path);
        create(path.parent().unwrap_or(folder))?;
        // What counts is white in all customs but instant-ngp's.
        let is_white: fn(bool) -> bool = match masks {
            Masks::Dynamic => |counts| !counts,
            _ => |counts| counts,
        };
        let mask = self.photo.mask.as_deref();
        Ok(picture::write_mask(&path, self.photo, mask, is_white)?)
    }
}

/// All photos of a scene in the order of their names, by which other programs count them.
pub(super) fn shots<'c>(capture: &Capture<'c>) -> Vec<Shot<'c>> {
    let mut taken = BTreeSet::new();
    let parts = [(capture.train, false), (capture.test, true)];
    let mut shots: Vec<Shot> = parts
        .into_iter()
        .flat_map(|(part, is_test)| part.photos.iter().map(move |photo| (part, photo, is_test)))
        .map(|(part, photo, is_test)| shot(part, photo, is_test, &mut taken))
        .collect();
    // Both parts together: programs that hold out every eighth photo count all of them.
    shots.sort_by(|a, b| a.name.cmp(&b.name));
    shots
}

fn shot<'c>(part: Part, photo: &'c Photo, is_test: bool, taken: &mut BTreeSet<String>) -> Shot<'c> {
    let mut name = photo.name.clone();
    // NeRF-synthetic counts from r_0 in both parts.
    while !taken.insert(name.clone()) {
        name = format!("test_{name}");
    }
    let exr = part
        .exr
        .map(|folder| folder.join(format!("{}.exr", photo.name)));
    Shot {
        name,
        photo,
        exr,
        is_test,
    }
}
