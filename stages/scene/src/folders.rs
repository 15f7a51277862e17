//! Which of several folders of photos to take: `images`, `images_2`, `images_4` … Looks into photos
//! only for their size.

use std::path::{Path, PathBuf};

use crate::finder::{self, Finder};
use crate::{SceneError, photo_file};

/// A folder of photos.
#[derive(Clone, Debug)]
pub(crate) struct Chosen {
    pub(crate) folder: PathBuf,
    /// Why it is not the one that its size would have made it.
    pub(crate) note: Option<String>,
}

/// A folder that could be taken.
struct Candidate {
    folder: PathBuf,
    /// Width and height of its first photo.
    size: (u32, u32),
    /// How many of the photos that are wanted it has.
    has: usize,
}

impl Candidate {
    fn area(&self) -> u64 {
        u64::from(self.size.0) * u64::from(self.size.1)
    }

    fn name(&self) -> String {
        let name = self.folder.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }
}

/// The subfolder `images` of a scene's folder, or without a name the smallest of `images`,
/// `images_2` … that has the most of the photos `named`, and is not below `size`; or the largest.
/// Without names, the most photos count.
pub(crate) fn choose(
    scene: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
    named: &[&str],
) -> Result<Chosen, SceneError> {
    if let Some(folder) = images.map(|name| scene.join(name)) {
        let holds_photos = folder.is_dir() && !finder::list_all(&folder)?.is_empty();
        return match holds_photos {
            true => Ok(Chosen { folder, note: None }),
            false => Err(no_photos(scene, folder)),
        };
    }
    let candidates = candidates(scene, named)?;
    let most = candidates.iter().map(|one| one.has).max().unwrap_or(0);
    let fits = |one: &&Candidate| {
        let (width, height) = one.size;
        size.is_some_and(|size| width >= size.0 && height >= size.1)
    };
    let best = |all: &dyn Fn(&Candidate) -> bool| {
        let possible = || candidates.iter().filter(|one| all(one));
        // By size: the smallest that fits costs least to read; else the largest loses least.
        possible().find(fits).or(possible().next_back())
    };
    // Only for the note: what would be taken if all folders had all photos.
    let by_size = best(&|_| true);
    let chosen =
        best(&|one| one.has == most).ok_or_else(|| no_photos(scene, scene.join("images")))?;
    let note = by_size
        .filter(|other| other.folder != chosen.folder)
        .map(|other| {
            format!(
                "{} has {} of {most} photos and is passed over: those of {} are taken",
                other.name(),
                other.has,
                chosen.name()
            )
        });
    Ok(Chosen {
        folder: chosen.folder.clone(),
        note,
    })
}

fn no_photos(scene: &Path, path: PathBuf) -> SceneError {
    if let Some(format) = finder::first_not_read(&path) {
        return SceneError::not_read(&path, format);
    }
    // Errors are passed over here, since the one about photos is already on its way.
    let there = candidates(scene, &[]).unwrap_or_default();
    let names: Vec<String> = there.iter().map(Candidate::name).collect();
    let remedy = match names.is_empty() {
        true => "put the photos into a subfolder `images`".into(),
        false => format!("there is: {}", names.join(", ")),
    };
    SceneError::Missing {
        path,
        expected: "a folder of photos",
        remedy: format!("{remedy} ({} are read)", photo_file::FORMATS),
    }
}

/// The subfolders `images` and `images_<factor>` that hold photos, smallest photos first.
fn candidates(scene: &Path, named: &[&str]) -> Result<Vec<Candidate>, SceneError> {
    let entries = std::fs::read_dir(scene).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let entries = entries.map_err(|source| SceneError::io(scene, source))?;
    let folders = entries.into_iter().map(|entry| entry.path());
    let mut found = Vec::new();
    for folder in folders.filter(|path| is_images_folder(path)) {
        let photos = finder::list_all(&folder)?;
        let Some(first) = photos.first() else {
            continue;
        };
        let finder = Finder::default();
        let has = match named {
            [] => photos.len(),
            _ => named
                .iter()
                .filter(|name| finder.find(&folder, name).photo().is_some())
                .count(),
        };
        found.push(Candidate {
            size: photo_file::size(first)?,
            has,
            folder,
        });
    }
    // The folder's name decides between equal areas, as directories have no order.
    found.sort_by_key(|one| (one.area(), one.folder.clone()));
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
