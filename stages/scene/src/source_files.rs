//! The files that a scene is read from, and their digest. Looks into photos only for their size.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::downscale::shrink_covered;
use crate::image_file::{self, Pixels};
use crate::{Camera, Photo, Reduction, SceneError};

const DIGEST_DOMAIN: &str = "srnerf-dag 2026 scene source files v1";
/// No file of poses or points comes near this many bytes.
const LARGEST_FILE: u64 = 4 << 30;
/// Photos reduced by whole factors differ from the full size's shape by a pixel's rounding, not by more.
pub(crate) const SAME_SHAPE: f64 = 0.03;

/// A photo yet to be read, with its camera at the file's own size.
#[derive(Clone, Debug)]
pub(crate) struct Posed {
    pub(crate) name: String,
    pub(crate) file: PathBuf,
    pub(crate) camera: Camera,
}

/// Reads the photos, resized to `size` if there is one by an antialiased bicubic filter; intrinsics follow exactly.
pub(crate) fn read_photos(
    posed: &[Posed],
    size: Option<(u32, u32)>,
) -> Result<Vec<Photo>, SceneError> {
    posed
        .par_iter()
        .map(|posed| read_photo(posed, size))
        .collect()
}

fn read_photo(posed: &Posed, size: Option<(u32, u32)>) -> Result<Photo, SceneError> {
    let Pixels {
        size: found,
        rgb,
        alpha,
    } = image_file::read(&posed.file)?;
    let size = size.unwrap_or(found);
    let (rgb, alpha) = shrink_covered(&rgb, alpha.as_deref(), found, size, Reduction::Bicubic);
    Ok(Photo {
        name: posed.name.clone(),
        camera: posed.camera.scaled(size.0, size.1),
        rgb,
        alpha,
    })
}

/// The camera of a photo whose file has another size than the poses were found at, such as a reduced copy.
pub(crate) fn at_size_of_file(camera: &Camera, file: &Path) -> Result<Camera, SceneError> {
    let size = image_file::size(file)?;
    let (x, y) = (
        f64::from(size.0) / f64::from(camera.width),
        f64::from(size.1) / f64::from(camera.height),
    );
    if (x / y - 1.0).abs() > SAME_SHAPE {
        let fault = format!(
            "is {}x{}, but its camera is for {}x{}: another aspect ratio",
            size.0, size.1, camera.width, camera.height
        );
        return Err(SceneError::content(file, "the photo", fault));
    }
    Ok(camera.scaled(size.0, size.1))
}

/// Refuses a requested size without pixels.
pub(crate) fn check_size(folder: &Path, size: Option<(u32, u32)>) -> Result<(), SceneError> {
    match size {
        Some(size @ ((0, _) | (_, 0))) => Err(SceneError::EmptyImage {
            what: format!("{}: the size asked for", folder.display()),
            size,
            remedy: "give a width and a height of at least one pixel",
        }),
        _ => Ok(()),
    }
}

/// A whole file. What is allocated is what the file really holds.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, SceneError> {
    let io = |source| SceneError::Io {
        path: path.into(),
        source,
    };
    let mut bytes = Vec::new();
    let read = File::open(path)
        .map_err(io)?
        .take(LARGEST_FILE + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if read as u64 > LARGEST_FILE {
        return Err(SceneError::content(path, "the file", "is over 4 GiB"));
    }
    Ok(bytes)
}

/// A BLAKE3 digest over the names and bytes of files, which are read side by side. It says whether a scene on disk has
/// changed, without decoding it.
pub(crate) fn digest<'a>(files: impl Iterator<Item = &'a Path>) -> Result<[u8; 32], SceneError> {
    let files: Vec<&Path> = files.collect();
    let contents: Vec<blake3::Hash> = files
        .par_iter()
        .map(|path| content_digest(path))
        .collect::<Result<_, _>>()?;
    let mut hasher = blake3::Hasher::new_derive_key(DIGEST_DOMAIN);
    for (path, content) in files.iter().zip(contents) {
        let name = path
            .file_name()
            .map(|name| name.as_encoded_bytes())
            .unwrap_or_default();
        hasher
            .update(&(name.len() as u64).to_le_bytes())
            .update(name)
            .update(content.as_bytes());
    }
    Ok(*hasher.finalize().as_bytes())
}

/// The digest of one file's bytes. Not from mapped memory: a photo may be cut short while it is read.
pub(crate) fn content_digest(path: &Path) -> Result<blake3::Hash, SceneError> {
    let io = |source| SceneError::Io {
        path: path.into(),
        source,
    };
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(File::open(path).map_err(io)?)
        .map_err(io)?;
    Ok(hasher.finalize())
}

/// Names of views for photos, by their paths: the stems where these differ, else whole paths with `_` between folders.
/// Whatever a path holds, the name can be a file's.
pub(crate) fn view_names(paths: &[&str]) -> Vec<String> {
    let whole = |path: &&str| clean(without_extension(path.trim_start_matches("./")));
    let stem = |path: &&str| whole(path.rsplit(['/', '\\']).next().as_ref().unwrap_or(path));
    let stems: Vec<String> = paths.iter().map(stem).collect();
    let mut sorted = stems.clone();
    sorted.sort();
    sorted.dedup();
    if sorted.len() == stems.len() {
        stems
    } else {
        paths.iter().map(whole).collect()
    }
}

fn without_extension(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, extension)) if !stem.is_empty() && image_file::is_extension(extension) => stem,
        _ => name,
    }
}

fn clean(name: &str) -> String {
    let safe = |c: char| {
        if c.is_control() || matches!(c, '/' | '\\' | ':') {
            '_'
        } else {
            c
        }
    };
    let name: String = name.trim_start_matches('.').chars().map(safe).collect();
    if name.is_empty() { "_".into() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_stems_unless_two_are_the_same() {
        assert_eq!(
            view_names(&["./train/r_0", "images/a.b.JPG"]),
            ["r_0", "a.b"]
        );
        assert_eq!(
            view_names(&["left/0.png", "./right/0.png"]),
            ["left_0", "right_0"]
        );
        assert_eq!(view_names(&["..\\x:y\n.png", ""]), ["x_y_", "_"]);
    }
}
