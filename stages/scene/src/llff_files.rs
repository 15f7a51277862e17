//! The files of an LLFF folder: which there are, which to take, and their digest. Looks into photos only for their
//! size.

use std::path::{Path, PathBuf};

use crate::{SceneError, image_file, source_files};

const POSES_FILE: &str = "poses_bounds.npy";

/// A folder of photos and the first one's width and height.
type Candidate = (PathBuf, (u32, u32));

/// The files that a scene is read from.
pub(crate) struct LlffFiles {
    pub(crate) poses: PathBuf,
    /// The folder that the photos are in.
    pub(crate) folder: PathBuf,
    /// The photos, sorted by name; at least one.
    pub(crate) photos: Vec<PathBuf>,
}

/// Finds the table of poses and the photos that fit `images` and `size` best; see [`crate::llff`].
pub(crate) fn find(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<LlffFiles, SceneError> {
    let poses = folder.join(POSES_FILE);
    if !poses.is_file() {
        let remedy =
            "point to an LLFF scene's folder, or make the file with LLFF's imgs2poses".into();
        return Err(SceneError::Missing {
            path: poses,
            expected: "the table of camera poses",
            remedy,
        });
    }
    let folder = choose_images(folder, images, size)?;
    Ok(LlffFiles {
        poses,
        photos: image_file::list(&folder)?,
        folder,
    })
}

/// A BLAKE3 digest over the table of poses and the names and bytes of the photos that [`crate::llff`] would read with
/// the same arguments. It says whether a scene on disk has changed, without decoding it.
///
/// # Errors
/// The same as [`crate::llff`]'s, but for photos that cannot be decoded.
pub fn llff_digest(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<[u8; 32], SceneError> {
    let (files, _) = crate::llff::survey(folder, images, size)?;
    source_files::digest(
        std::iter::once(&files.poses)
            .chain(&files.photos)
            .map(PathBuf::as_path),
    )
}

pub(crate) fn choose_images(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<PathBuf, SceneError> {
    if let Some(path) = images.map(|name| folder.join(name)) {
        let holds_photos = path.is_dir() && !image_file::list(&path)?.is_empty();
        return if holds_photos {
            Ok(path)
        } else {
            Err(no_photos(folder, path))
        };
    }
    let candidates = candidates(folder)?;
    let fits = |&&(_, (w, h)): &&Candidate| size.is_some_and(|size| w >= size.0 && h >= size.1);
    let chosen = candidates.iter().find(fits).or(candidates.last());
    chosen
        .map(|(path, _)| path.clone())
        .ok_or_else(|| no_photos(folder, folder.join("images")))
}

fn no_photos(folder: &Path, path: PathBuf) -> SceneError {
    let there = candidates(folder).unwrap_or_default();
    let names: Vec<_> = there
        .iter()
        .filter_map(|(path, _)| path.file_name()?.to_str())
        .collect();
    let remedy = match names.as_slice() {
        [] => "put the photos into a subfolder `images`".into(),
        names => format!("there is: {}", names.join(", ")),
    };
    SceneError::Missing {
        path,
        expected: "a folder of PNG or JPEG photos",
        remedy,
    }
}

/// The subfolders `images` and `images_<factor>` that hold photos, with their first photo's size, smallest first.
fn candidates(folder: &Path) -> Result<Vec<Candidate>, SceneError> {
    let io = |source| SceneError::Io {
        path: folder.into(),
        source,
    };
    let entries: Result<Vec<_>, _> = std::fs::read_dir(folder).map_err(io)?.collect();
    let mut found = Vec::new();
    for path in entries
        .map_err(io)?
        .into_iter()
        .map(|entry| entry.path())
        .filter(|path| is_images_folder(path))
    {
        if let Some(first) = image_file::list(&path)?.first() {
            found.push((path, image_file::size(first)?));
        }
    }
    found.sort_by_key(|(path, (width, height))| {
        (u64::from(*width) * u64::from(*height), path.clone())
    });
    Ok(found)
}

fn is_images_folder(path: &Path) -> bool {
    let name = path
        .file_name()
        .and_then(|name| name.to_str())
        .and_then(|name| name.strip_prefix("images"));
    let factor = |suffix: &str| {
        suffix
            .strip_prefix('_')
            .is_some_and(|f| f.parse::<u32>().is_ok())
    };
    path.is_dir() && name.is_some_and(|suffix| suffix.is_empty() || factor(suffix))
}

/// The one size that all photos have, from their headers, before any of them is decoded.
pub(crate) fn one_size(files: &[PathBuf]) -> Result<(u32, u32), SceneError> {
    let sizes = files
        .iter()
        .map(|file| image_file::size(file))
        .collect::<Result<Vec<_>, _>>()?;
    match sizes.iter().position(|size| *size != sizes[0]) {
        None => Ok(sizes[0]),
        Some(odd) => Err(SceneError::MixedSizes {
            path: files[odd].clone(),
            size: sizes[odd],
            first: files[0].clone(),
            first_size: sizes[0],
        }),
    }
}
