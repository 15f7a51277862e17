//! What lies in a folder that a stage reads beside its inputs. Looks into no file.

use std::path::{Path, PathBuf};

/// A folder with more than this in it was not meant.
const MOST: usize = 100_000;

/// A folder and all that is in it and below it; `None` if it cannot be listed, or has no end.
pub fn tree(folder: &Path) -> Option<Vec<PathBuf>> {
    let mut found = vec![folder.to_owned()];
    let mut next = 0;
    while let Some(path) = found.get(next).cloned() {
        next += 1;
        // A link to a folder further up would never end; one to a file is followed by whoever reads
        // it.
        let is_folder =
            // The folder that was named may be a link itself, and what it leads to was meant.
            std::fs::symlink_metadata(&path).ok()?.is_dir() || (next == 1 && path.is_dir());
        if is_folder {
            for entry in std::fs::read_dir(&path).ok()? {
                found.push(entry.ok()?.path());
            }
        } else if path.is_dir() {
            return None;
        }
        if found.len() > MOST {
            return None;
        }
    }
    // The file system gives entries in any order, and what is made of the list must not depend on
    // it.
    found.sort();
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_below_a_folder_is_listed() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("a")).unwrap();
        std::fs::write(folder.path().join("a/x"), "1").unwrap();
        std::fs::write(folder.path().join("b"), "2").unwrap();
        let names: Vec<PathBuf> = ["", "a", "a/x", "b"]
            .map(|name| folder.path().join(name))
            .into();
        assert_eq!(tree(folder.path()), Some(names));
        assert_eq!(tree(&folder.path().join("none")), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_holds_itself_has_no_end() {
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(folder.path(), folder.path().join("again")).unwrap();
        assert_eq!(tree(folder.path()), None);
    }
}
