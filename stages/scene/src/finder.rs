//! Finds photos by the paths that files of poses give them, on whatever machine those were written:
//! with backslashes, in another case, without or with another ending, or absolute. Looks into no
//! photo.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use crate::SceneError;
use crate::photo_file;

/// A folder with more photos than this below it was not meant.
const MOST_PHOTOS: usize = 1 << 20;
/// Folders in folders deeper than this were not meant.
const DEEPEST: usize = 16;
/// How names of masks that instant-ngp reads beside a photo begin.
pub(crate) const DYNAMIC_MASK: &str = "dynamic_mask_";

/// Where the photo lies that a path means.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Found {
    /// The photo that lies there, in a format that is read.
    Photo(PathBuf),
    /// Here, in a format that is not read.
    NotRead(PathBuf, &'static str),
    /// No place that was tried has it.
    Missing,
}

impl Found {
    /// The photo, if it is there and its format is read.
    pub(crate) fn photo(self) -> Option<PathBuf> {
        match self {
            Found::Photo(path) => Some(path),
            Found::NotRead(..) | Found::Missing => None,
        }
    }
}

/// Names in a folder, by themselves without a photo's ending and in lower case.
type Listing = Rc<BTreeMap<String, Vec<String>>>;

/// Looks for photos, and remembers what it has seen of folders.
#[derive(Default)]
pub(crate) struct Finder {
    listings: RefCell<BTreeMap<PathBuf, Listing>>,
}

impl Finder {
    /// The photo that `named` means, seen from `folder`.
    pub(crate) fn find(&self, folder: &Path, named: &str) -> Found {
        // The usual case costs no listing of the folder.
        let exact = folder.join(named);
        if is_photo(&exact) {
            return Found::Photo(exact);
        }
        // Poses may come from Windows, and a backslash is part of a name elsewhere.
        let slashed = named.replace('\\', "/");
        let mut not_read = None;
        for candidate in candidates(&slashed) {
            match self.resolve(folder, candidate) {
                Some(Found::Photo(path)) => return Found::Photo(path),
                // Remembered only: a shorter end of the path may yet lead to one that is read.
                Some(Found::NotRead(path, format)) => {
                    not_read.get_or_insert(Found::NotRead(path, format));
                }
                Some(Found::Missing) | None => {}
            }
        }
        not_read.unwrap_or(Found::Missing)
    }

    /// Follows a path part by part, where need be in another case.
    fn resolve(&self, folder: &Path, path: &str) -> Option<Found> {
        let parts: Vec<&str> = path
            .split('/')
            .filter(|part| !part.is_empty() && *part != ".")
            .collect();
        let (last, folders) = parts.split_last()?;
        let mut at = match path.starts_with('/') {
            true => PathBuf::from("/"),
            false => folder.to_owned(),
        };
        for part in folders {
            // An exact name first: where case matters, two folders may differ by it alone.
            let exact = at.join(part);
            at = match exact.is_dir() {
                true => exact,
                false => at.join(self.in_any_case(&at, part)?),
            };
        }
        self.in_folder(&at, last)
    }

    fn in_any_case(&self, folder: &Path, name: &str) -> Option<String> {
        let wanted = name.to_lowercase();
        let listing = self.listing(folder);
        // Listings have names without photos' endings as keys, folders' names too.
        let alike = listing.get(photo_file::split(&wanted).0)?;
        alike
            .iter()
            .find(|other| other.to_lowercase() == wanted)
            .cloned()
    }

    /// The photo of this name: as it is, in another case, with another ending, or with one at all.
    fn in_folder(&self, folder: &Path, name: &str) -> Option<Found> {
        let wanted = name.to_lowercase();
        let listing = self.listing(folder);
        let alike = listing
            .get(photo_file::split(&wanted).0)
            .into_iter()
            // Also a file with one more ending than the name: `a.jpg.png`.
            .chain(listing.get(&wanted))
            .flatten();
        // Formats that are read come before others, and then the whole name in another case before
        // another ending.
        let best = alike
            .filter_map(|other| {
                let ending = photo_file::split(other).1?;
                let rank = photo_file::rank(ending);
                let close = (*other != name, other.to_lowercase() != wanted);
                Some((rank.is_none(), close, rank, other, ending))
            })
            // A folder may be named like a photo.
            .filter(|(.., other, _)| folder.join(other).is_file())
            .min()?;
        let (.., other, ending) = best;
        let path = folder.join(other);
        Some(match photo_file::not_read(ending) {
            Some(format) => Found::NotRead(path, format),
            None => Found::Photo(path),
        })
    }

    fn listing(&self, folder: &Path) -> Listing {
        let mut listings = self.listings.borrow_mut();
        listings
            .entry(folder.to_owned())
            .or_insert_with(|| {
                let mut listing: BTreeMap<String, Vec<String>> = BTreeMap::new();
                for name in list_names(folder) {
                    let key = photo_file::split(&name).0.to_lowercase();
                    listing.entry(key).or_default().push(name);
                }
                Rc::new(listing)
            })
            .clone()
    }
}

/// A path, and, if it leads out of the scene's folder, ever shorter ends of it: it may be from
/// another machine.
fn candidates(path: &str) -> impl Iterator<Item = &str> {
    // `C:` of Windows.
    let is_drive = path.as_bytes().get(1) == Some(&b':');
    let leads_out = path.starts_with('/') || path.starts_with("../") || is_drive;
    let ends = path
        .match_indices('/')
        .map(|(at, _)| &path[at + 1..])
        .filter(move |_| leads_out);
    std::iter::once(path).chain(ends)
}

fn list_names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        // Hidden files are none of the user's photos, as macOS's `._name.jpg`.
        .filter(|name| !name.starts_with('.'))
        .collect();
    names.sort();
    names
}

/// Whether a path is that of a visible file whose name ends as photos' do.
fn is_photo(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    let named =
        |name: &str| !name.starts_with('.') && photo_file::split(name).1.is_some_and(is_read);
    name.is_some_and(named) && path.is_file()
}

fn is_read(ending: &str) -> bool {
    photo_file::rank(ending).is_some()
}

/// The photos right in a folder, sorted by name bytewise, so the same everywhere. Masks are none.
pub(crate) fn list(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let mut files: Vec<PathBuf> = entries
        .map_err(|source| SceneError::io(folder, source))?
        .iter()
        .map(std::fs::DirEntry::path)
        .filter(|path| is_photo(path) && !is_mask(path))
        .collect();
    files.sort();
    Ok(files)
}

/// The photos in a folder and in the folders below it, sorted by path.
pub(crate) fn list_all(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let mut photos = list(folder)?;
    let mut folders = vec![(folder.to_owned(), 0)];
    while let Some((folder, depth)) = folders.pop() {
        for name in list_names(&folder) {
            let path = folder.join(name);
            // Links to folders are not followed: one that leads upwards would never end.
            let is_folder = std::fs::symlink_metadata(&path).is_ok_and(|about| about.is_dir());
            if is_folder && depth < DEEPEST && photos.len() < MOST_PHOTOS {
                photos.extend(list(&path)?);
                folders.push((path, depth + 1));
            }
        }
    }
    // The stack visits folders in no order of names.
    photos.sort();
    Ok(photos)
}

/// The first photo or film right in a folder of a format that is not read, if there is one.
pub(crate) fn first_not_read(folder: &Path) -> Option<&'static str> {
    let names = list_names(folder);
    let format = |name: &String| photo_file::not_read(photo_file::split(name).1?);
    names.iter().find_map(format)
}

fn is_mask(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.to_lowercase().starts_with(DYNAMIC_MASK))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        folder
    }

    fn found(folder: &tempfile::TempDir, named: &str) -> Option<String> {
        let photo = Finder::default().find(folder.path(), named).photo()?;
        let inside = photo.strip_prefix(folder.path()).unwrap();
        Some(inside.to_str().unwrap().to_owned())
    }

    #[test]
    fn photos_are_found_however_their_path_was_written() {
        let folder = folder(&["Images/a.JPG", "Images/b.png", "Images/b.webp", "r_0.5.png"]);
        for (named, at) in [
            ("images\\a.jpg", "Images/a.JPG"),
            ("./images/a.png", "Images/a.JPG"),
            ("images/b.jpeg", "Images/b.png"),
            ("C:\\Users\\me\\images\\b.webp", "Images/b.webp"),
            ("/home/me/scene/Images/a", "Images/a.JPG"),
            ("../elsewhere/images/A.JPG", "Images/a.JPG"),
            ("r_0.5", "r_0.5.png"),
        ] {
            assert_eq!(found(&folder, named).as_deref(), Some(at), "{named}");
        }
        assert_eq!(found(&folder, "images/c.jpg"), None);
        assert_eq!(found(&folder, ""), None);
    }

    #[test]
    fn a_photo_in_a_format_that_is_not_read_is_not_called_missing() {
        let folder = folder(&["images/a.HEIC"]);
        let found = Finder::default().find(folder.path(), "images/a.jpg");
        assert_eq!(
            found,
            Found::NotRead(folder.path().join("images/a.HEIC"), "HEIC")
        );
    }

    #[test]
    fn only_visible_photos_are_listed_and_in_order() {
        let folder = folder(&[
            "b.PNG",
            "a.jpg",
            "notes.txt",
            ".c.png",
            "dynamic_mask_a.png",
            "a10.jpeg",
            "a2.jpeg",
            "left/z.png",
        ]);
        let names = |photos: Vec<PathBuf>| {
            let name = |path: PathBuf| {
                let inside = path.strip_prefix(folder.path()).unwrap();
                inside.to_str().unwrap().to_owned()
            };
            photos.into_iter().map(name).collect::<Vec<_>>()
        };
        let flat = ["a.jpg", "a10.jpeg", "a2.jpeg", "b.PNG"];
        assert_eq!(names(list(folder.path()).unwrap()), flat);
        let all = [&flat[..], &["left/z.png"]].concat();
        assert_eq!(names(list_all(folder.path()).unwrap()), all);
    }
}
