//! Whole folders: what lies in them, and the first file in which two of them differ.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::space::Space;

/// The files of a folder by their paths in it, with their bytes.
pub type Files = BTreeMap<PathBuf, Vec<u8>>;

impl Space {
    /// All files under a folder with their bytes; none if there is no such folder.
    pub fn files(&self, folder: &str) -> Files {
        let folder = self.path(folder);
        let mut files = Files::new();
        collect(&folder, &folder, &mut files);
        files
    }

    /// A folder holds these files. Says which one differs first.
    #[track_caller]
    pub fn assert_files(&self, folder: &str, expected: &Files) {
        assert_eq!(difference(&self.files(folder), expected), None, "{folder}");
    }
}

fn collect(root: &Path, folder: &Path, files: &mut Files) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(root, &path, files);
        } else {
            let inside = path.strip_prefix(root).unwrap().to_owned();
            files.insert(inside, fs::read(&path).unwrap());
        }
    }
}

/// Two folders of a space hold the same files. Says which one differs first.
#[track_caller]
pub fn assert_same_files(space: &Space, one: &str, other: &str) {
    space.assert_files(other, &space.files(one));
}

/// What first tells files from those that are expected.
fn difference(files: &Files, expected: &Files) -> Option<String> {
    let names: BTreeSet<_> = files.keys().chain(expected.keys()).collect();
    let told = |name: &PathBuf| match (files.get(name), expected.get(name)) {
        (Some(a), Some(b)) if a == b => None,
        (Some(a), Some(b)) => {
            let byte = a.iter().zip(b).position(|(a, b)| a != b);
            let sizes = format!("{} bytes, not {}", a.len(), b.len());
            Some(format!(
                "{}: {sizes}, byte {byte:?} differs",
                name.display()
            ))
        }
        (None, _) => Some(format!("{} is missing", name.display())),
        (_, None) => Some(format!("{} is not expected", name.display())),
    };
    names.into_iter().find_map(told)
}
