//! Masks: which pixels of a photo count. Finds their files and reads them; knows no poses.
//!
//! Three customs: nerfstudio's `mask_path` and COLMAP's `masks/NAME.png` leave out what is black,
//! instant-ngp's `dynamic_mask_NAME.png` beside the photo leaves out what is not.

use std::path::{Path, PathBuf};

use formats::Camera;
use image::metadata::Orientation;

use crate::downscale::shrink;
use crate::finder::{DYNAMIC_MASK, Finder};
use crate::{Reducer, SceneError, photo_file};

/// The folder of COLMAP's masks, beside that of the photos.
const FOLDER: &str = "masks";
/// A reduced pixel counts if all of it does, but for rounding.
const WHOLE: f32 = 0.999;
/// Values of a mask from this one on are white.
const WHITE: f32 = 0.5;
/// Masks may differ from their photos' shape by a pixel's rounding, not by more.
const SAME_SHAPE: f64 = 0.03;

/// A mask yet to be read.
#[derive(Clone, Debug)]
pub(crate) struct MaskFile {
    pub(crate) path: PathBuf,
    /// Whether the white part is left out, instead of the black one.
    white_is_out: bool,
}

impl MaskFile {
    /// A mask whose black part is left out.
    pub(crate) fn black_is_out(path: PathBuf) -> Self {
        Self {
            path,
            white_is_out: false,
        }
    }

    /// The mask of a photo by the customs of instant-ngp and COLMAP: `named` is the photo's path as
    /// the poses give it, `scene` the folder that `masks` lies in.
    pub(crate) fn of(finder: &Finder, scene: &Path, photo: &Path, named: &str) -> Option<Self> {
        let stem = photo.file_stem()?.to_str()?;
        let beside = photo.with_file_name(format!("{DYNAMIC_MASK}{stem}.png"));
        // The nearest to the photo first, should both customs be followed.
        if beside.is_file() {
            return Some(Self {
                path: beside,
                white_is_out: true,
            });
        }
        let folder = scene.join(FOLDER);
        if !folder.is_dir() {
            return None;
        }
        let named = named.replace('\\', "/");
        // In the folder of masks the photos' own folder may or may not be repeated.
        let ends = named.match_indices('/').map(|(at, _)| &named[at + 1..]);
        let find = |path: &str| finder.find(&folder, path).photo();
        std::iter::once(named.as_str())
            .chain(ends)
            // `IMG.jpg.png` first, as COLMAP has it; then `IMG` with any photo's ending.
            .find_map(|end| find(&format!("{end}.png")).or_else(|| find(end)))
            .map(Self::black_is_out)
    }

    /// Which pixels of a photo with this camera count, one value each.
    pub(crate) fn read(&self, camera: &Camera, turn: Orientation) -> Result<Vec<bool>, SceneError> {
        let (size, grey) = photo_file::read_grey(&self.path, turn)?;
        let shape = |(width, height): (u32, u32)| f64::from(width) / f64::from(height);
        let wanted = (camera.width, camera.height);
        // Masks are stretched to their photo, so another shape would mask other things.
        if (shape(size) / shape(wanted) - 1.0).abs() > SAME_SHAPE {
            let fault = format!(
                "is {}x{}, its photo {}x{}: another aspect ratio",
                size.0, size.1, wanted.0, wanted.1
            );
            return Err(SceneError::content(&self.path, "the mask", fault));
        }
        let counts: Vec<bool> = grey
            .iter()
            .map(|value| (*value >= WHITE) != self.white_is_out)
            .collect();
        Ok(reduced(&counts, size, wanted))
    }
}

/// A mask at another size. A new pixel counts if all of it does.
pub(crate) fn reduced(counts: &[bool], size: (u32, u32), new_size: (u32, u32)) -> Vec<bool> {
    if size == new_size {
        return counts.to_vec();
    }
    let parts: Vec<f32> = counts
        .iter()
        .map(|counts| f32::from(u8::from(*counts)))
        .collect();
    // By area: a new pixel counts only if all that it lies on does.
    shrink(&parts, 1, size, new_size, Reducer::Area)
        .into_iter()
        .map(|part| part >= WHOLE)
        .collect()
}

/// Pixels of a fisheye that lie beyond its rim have no ray; `None` where all have one.
pub(crate) fn inside_rim(camera: &Camera) -> Option<Vec<bool>> {
    if !camera.distortion.fisheye {
        return None;
    }
    let has_ray = |i: u32| {
        let [x, y] = [i % camera.width, i / camera.width].map(f64::from);
        // All four corners of the pixel: rays go through all of it.
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
            .iter()
            .all(|(right, down)| camera.has_ray(x + right, y + down))
    };
    let inside: Vec<bool> = (0..camera.width * camera.height).map(has_ray).collect();
    // Without a pixel beyond the rim no mask is stored.
    inside.contains(&false).then_some(inside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reduced_pixel_counts_if_all_of_it_does() {
        let counts = [true, true, false, true, true, true, true, true];
        assert_eq!(reduced(&counts, (4, 2), (2, 1)), [true, false]);
        assert_eq!(reduced(&counts, (4, 2), (4, 2)), counts);
    }
}
