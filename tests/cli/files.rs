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

/// Two folders of a space hold the same files.
pub fn assert_same_files(space: &Space, one: &str, other: &str) {
    assert_same((one, &space.files(one)), (other, &space.files(other)));
}

/// A folder holds the files that it held before.
pub fn assert_still_holds(space: &Space, folder: &str, before: &Files) {
    let was = format!("{folder} as it was");
    assert_same((folder, &space.files(folder)), (&was, before));
}

/// Says which file differs first, and where.
fn assert_same((one, ours): (&str, &Files), (other, theirs): (&str, &Files)) {
    let names: BTreeSet<_> = ours.keys().chain(theirs.keys()).collect();
    for name in names {
        let shown = name.display();
        match (ours.get(name), theirs.get(name)) {
            (Some(a), Some(b)) => {
                let differs = a.iter().zip(b).position(|(a, b)| a != b);
                let sizes = format!("{} and {} bytes", a.len(), b.len());
                assert!(
                    a == b,
                    "{shown} of {one} and {other}: {sizes}, byte {differs:?} differs"
                );
            }
            (Some(_), None) => panic!("{shown} is in {one} and not in {other}"),
            (None, _) => panic!("{shown} is in {other} and not in {one}"),
        }
    }
}
