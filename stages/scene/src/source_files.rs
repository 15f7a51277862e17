//! The files that a scene is read from: their bytes, their digest, and names of views after them.
//! Looks into no photo.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use rayon::prelude::*;

use crate::{SceneError, photo_file};

const DIGEST_DOMAIN: &str = "srnerf-dag 2026 scene source files v1";
/// No file of poses or points comes near this many bytes.
const LARGEST_FILE: u64 = 4 << 30;

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

/// A whole file of poses or points. What is allocated is what the file really holds.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, SceneError> {
    let bytes = read_bytes(path)?;
    match photo_file::is_lfs_pointer(&bytes) {
        true => Err(SceneError::not_fetched(path)),
        false => Ok(bytes),
    }
}

/// The text of a file, with or without a byte order mark, in UTF-8 or UTF-16 as Windows' own
/// editors write.
pub(crate) fn as_text(bytes: Vec<u8>) -> Result<String, String> {
    let utf16 = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest
            // A last odd byte is dropped; what is missing then shows as a fault of the text.
            .chunks_exact(2)
            .map(|pair| unit([pair[0], pair[1]]))
            .collect();
        String::from_utf16(&units).map_err(|_| "is not UTF-16, as its first bytes say".to_owned())
    };
    match bytes.as_slice() {
        [0xFF, 0xFE, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, u16::from_be_bytes),
        [0xEF, 0xBB, 0xBF, rest @ ..] => utf8(rest.to_vec()),
        _ => utf8(bytes),
    }
}

fn utf8(bytes: Vec<u8>) -> Result<String, String> {
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        format!("is not UTF-8 from byte {at} on: save it as UTF-8 text")
    })
}

/// The bytes of a file.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>, SceneError> {
    let io = |source| SceneError::io(path, source);
    let mut bytes = Vec::new();
    let read = File::open(path)
        .map_err(io)?
        // One byte more than is allowed tells a file that is too large from one that just fits.
        .take(LARGEST_FILE + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if read as u64 > LARGEST_FILE {
        return Err(SceneError::content(path, "the file", "is over 4 GiB"));
    }
    Ok(bytes)
}

/// A BLAKE3 digest over the names and bytes of files, which are read side by side. It says whether
/// a scene on disk has changed, without decoding it.
pub(crate) fn digest<'a>(files: impl Iterator<Item = &'a Path>) -> Result<[u8; 32], SceneError> {
    let files: Vec<&Path> = files.collect();
    // Side by side; combined in order below, so the digest does not depend on threads.
    let contents: Vec<_> = files.par_iter().map(|path| content_digest(path)).collect();
    // The first fault in order: collected at once, it would be any thread's.
    let contents = contents
        .into_iter()
        .collect::<Result<Vec<blake3::Hash>, _>>()?;
    let mut hasher = blake3::Hasher::new_derive_key(DIGEST_DOMAIN);
    for (path, content) in files.iter().zip(contents) {
        let name = path
            .file_name()
            .map(|name| name.as_encoded_bytes())
            .unwrap_or_default();
        // Names without their folders: a scene that is moved stays the same.
        hasher
            // With its length, so that bytes cannot move between a name and what follows.
            .update(&(name.len() as u64).to_le_bytes())
            .update(name)
            .update(content.as_bytes());
    }
    Ok(*hasher.finalize().as_bytes())
}

/// The digest of one file's bytes. Not from mapped memory: a photo may be cut short while it is
/// read.
pub(crate) fn content_digest(path: &Path) -> Result<blake3::Hash, SceneError> {
    let io = |source| SceneError::io(path, source);
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(File::open(path).map_err(io)?)
        .map_err(io)?;
    Ok(hasher.finalize())
}

/// Names of views for photos, by their paths: the stems where these differ, else whole paths with
/// `_` between folders, with their endings where need be. Whatever a path holds, the name can be a
/// file's.
pub(crate) fn view_names(paths: &[&str]) -> Vec<String> {
    let stem = |path: &&str| clean(photo_file::split(last(path)).0);
    let whole = |path: &&str| clean(photo_file::split(inside(path)).0);
    let with_ending = |path: &&str| clean(inside(path));
    let stems: Vec<String> = paths.iter().map(stem).collect();
    // The shortest names that tell all photos apart.
    if are_different(&stems) {
        return stems;
    }
    let wholes: Vec<String> = paths.iter().map(whole).collect();
    if are_different(&wholes) {
        return wholes;
    }
    // Photos may still share a name, such as `a/b` and `a_b`; `refuse_twice` names them.
    paths.iter().map(with_ending).collect()
}

fn inside(path: &str) -> &str {
    path.trim_start_matches("./")
}

fn last(path: &str) -> &str {
    let path = inside(path);
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

fn are_different(names: &[String]) -> bool {
    first_twice(names).is_none()
}

/// A name that occurs twice.
pub(crate) fn first_twice(names: &[String]) -> Option<&String> {
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort();
    sorted
        .windows(2)
        .find(|pair| pair[0] == pair[1])
        .map(|pair| pair[0])
}

fn clean(name: &str) -> String {
    // Names become files, also on systems where `:` and `\\` separate.
    let safe = |c: char| {
        if c.is_control() || matches!(c, '/' | '\\' | ':') {
            '_'
        } else {
            c
        }
    };
    // A leading dot would hide the file, and `..` would leave the folder.
    let name: String = name.trim_start_matches('.').chars().map(safe).collect();
    if name.is_empty() { "_".into() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read_with_any_byte_order_mark() {
        let read = |bytes: &[u8]| as_text(bytes.to_vec());
        assert_eq!(read(b"{}").unwrap(), "{}");
        assert_eq!(read(b"\xEF\xBB\xBF{}").unwrap(), "{}");
        assert_eq!(read(b"\xFF\xFE{\0}\0").unwrap(), "{}");
        assert_eq!(read(b"\xFE\xFF\0{\0}").unwrap(), "{}");
        assert!(read(b"ab\xFF").unwrap_err().contains("from byte 2"));
    }

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
        assert_eq!(view_names(&["a.png", "a.jpg"]), ["a.png", "a.jpg"]);
        assert_eq!(view_names(&["..\\x:y\n.png", ""]), ["x_y_", "_"]);
    }
}
