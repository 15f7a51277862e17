//! The photos that poses are found for, in a folder of their own: links to somebody's files, or
//! frames of a video. Changes nothing where they lie.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use walkdir::WalkDir;

use super::step::{self, ImportProgress};
use super::{Import, ImportError};

/// Endings of photos that every COLMAP reads.
const PHOTOS: &[&str] = &["jpg", "jpeg", "png", "tif", "tiff"];
/// Endings of videos.
const VIDEOS: &[&str] = &["mp4", "mov", "m4v", "mkv", "webm", "avi"];

/// Photos in `images`.
pub struct Gathered {
    pub count: usize,
    /// All have one size, so that one lens made them.
    pub one_size: bool,
    /// They are frames, in their order.
    pub is_video: bool,
}

/// Fills the folder `images` in `work`.
pub fn gather(
    import: &Import,
    work: &Path,
    progress: &mut dyn ImportProgress,
) -> Result<Gathered, ImportError> {
    let images = work.join("images");
    fs::create_dir(&images).map_err(|error| ImportError::file(&images, error))?;
    let is_video = import.photos.is_file() && ends_in(&import.photos, VIDEOS);
    match is_video {
        true => take_frames(import, &images, work, progress)?,
        false => link_all(&import.photos, &images)?,
    }
    let found = photos_in(&images)?;
    if found.is_empty() {
        return Err(ImportError::NoPhotos {
            path: import.photos.clone(),
        });
    }
    Ok(Gathered {
        count: found.len(),
        one_size: are_of_one_size(&found),
        is_video,
    })
}

fn ends_in(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| endings.contains(&ending.to_ascii_lowercase().as_str()))
}

/// The photos in a folder and the folders in it, in the order of their names.
fn photos_in(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut photos = Vec::new();
    for entry in WalkDir::new(folder).sort_by_file_name().follow_links(true) {
        let entry = entry.map_err(|error| ImportError::file(folder, error.into()))?;
        if entry.file_type().is_file() && ends_in(entry.path(), PHOTOS) {
            photos.push(entry.into_path());
        }
    }
    Ok(photos)
}

/// Links to all photos of a folder, with the folders that they lie in; copies where there can be no
/// links.
fn link_all(folder: &Path, images: &Path) -> Result<(), ImportError> {
    // Reduced copies lie beside `images` in many scenes, and would be taken for other photos.
    let own = folder.join("images");
    let folder = match own.is_dir() {
        true => own.as_path(),
        false => folder,
    };
    for photo in photos_in(folder)? {
        // With its folders: photos in several of them may have one name.
        let name = photo.strip_prefix(folder).unwrap_or(&photo);
        let link = images.join(name);
        let parent = link.parent().unwrap_or(images);
        fs::create_dir_all(parent).map_err(|error| ImportError::file(parent, error))?;
        // A link to a symbolic link would lead nowhere from its new place.
        let file = fs::canonicalize(&photo);
        file.and_then(|file| {
            fs::hard_link(&file, &link).or_else(|_| fs::copy(&file, &link).map(drop))
        })
        .map_err(|error| ImportError::file(&photo, error))?;
    }
    Ok(())
}

fn take_frames(
    import: &Import,
    images: &Path,
    work: &Path,
    progress: &mut dyn ImportProgress,
) -> Result<(), ImportError> {
    let version = Command::new("ffmpeg").arg("-version").output();
    // Asked first, so that a missing program is told apart from a video that it cannot read.
    version.map_err(|error| ImportError::NoFfmpeg {
        path: import.photos.clone(),
        error,
    })?;
    let mut command = Command::new("ffmpeg");
    command.args(["-nostdin", "-loglevel", "warning", "-i"]);
    let photos = std::path::absolute(&import.photos);
    let photos = photos.map_err(|error| ImportError::file(&import.photos, error))?;
    // With a protocol, so that a colon in the name does not begin another.
    let mut video = OsString::from("file:");
    video.push(photos);
    command.arg(video);
    // Of ffmpeg's qualities of a JPEG, 2 is the best that it gives by default.
    command.args(["-vf", &format!("fps={}", import.rate), "-qscale:v", "2"]);
    // In the folder that it writes to: a percent sign in its name would be taken for a pattern. And of
    // one width, so that the order of names is that of time.
    command.current_dir(images).arg("%05d.jpg");
    step::run("taking frames", &mut command, work, progress, |_| None)
}

/// Whether all photos have one size, as far as it can be read.
fn are_of_one_size(photos: &[PathBuf]) -> bool {
    let mut sizes = photos
        .iter()
        .map(|photo| image::image_dimensions(photo).ok());
    // Read from the head of each file: nothing is decoded.
    let first = sizes.next().flatten();
    first.is_some() && sizes.all(|size| size == first)
}
