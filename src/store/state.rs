//! The last states of finished results, from which longer runs go on. Knows nothing of what is in
//! them.
//!
//! `states/<extension key>/<key>` was left by the result of that key. There is one for an extension
//! key, the latest.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use artifacts_schema::Digest;

use super::Store;
use super::error::{At, StoreError};
use super::files::parent;
use super::listing::{Entry, list};

/// The state that the latest result of an extension key has left.
pub fn latest(store: &Store, extension: &Digest) -> Option<PathBuf> {
    // There is one, but for the moment in which the next has come and the last is not yet gone.
    let age = |path: &PathBuf| {
        fs::metadata(path)
            .and_then(|data| data.modified())
            .unwrap_or(SystemTime::UNIX_EPOCH)
    };
    all(store, extension).into_iter().max_by_key(age)
}

/// Keeps a file as the state of a result, in place of the one before.
pub(super) fn keep(
    store: &Store,
    extension: &Digest,
    key: &Digest,
    file: &Path,
) -> Result<(), StoreError> {
    let path = folder(store, extension).join(key.to_string());
    let folder = parent(&path);
    store
        .files
        .disk
        .create_folders(folder)
        .at("create", folder)?;
    // The new state comes before the old one goes, so that there is always one. The keeper has
    // flushed the file.
    store.files.disk.rename(file, &path).at("write", &path)?;
    for other in all(store, extension).iter().filter(|other| **other != path) {
        store.files.disk.remove_file(other).at("remove", other)?;
    }
    Ok(())
}

/// The states that are to go; where none stays, their folder.
pub(super) fn going(
    store: &Store,
    goes: &dyn Fn(&Entry) -> bool,
) -> Result<Vec<PathBuf>, StoreError> {
    let mut paths = Vec::new();
    let is_folder = |entry: &Entry| entry.data.is_dir();
    for folder in store.files.entries("states")?.into_iter().filter(is_folder) {
        let (going, staying): (Vec<_>, Vec<_>) = list(&folder.path)?.into_iter().partition(goes);
        // The folder as a whole, or it would stay behind empty.
        if staying.is_empty() {
            paths.push(folder.path);
        } else {
            paths.extend(going.into_iter().map(|entry| entry.path));
        }
    }
    Ok(paths)
}

fn folder(store: &Store, extension: &Digest) -> PathBuf {
    store.files.root.join("states").join(extension.to_string())
}

fn all(store: &Store, extension: &Digest) -> Vec<PathBuf> {
    fs::read_dir(folder(store, extension))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::testing::key;
    use super::*;

    #[test]
    fn the_latest_result_of_an_extension_key_leaves_its_state() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::create(folder.path()).unwrap();
        assert_eq!(latest(&store, &key("e")), None);
        for result in ["a", "b"] {
            let file = folder.path().join("checkpoint");
            fs::write(&file, result).unwrap();
            keep(&store, &key("e"), &key(result), &file).unwrap();
            assert_eq!(
                fs::read_to_string(latest(&store, &key("e")).unwrap()).unwrap(),
                result
            );
        }
        assert_eq!(all(&store, &key("e")).len(), 1);
        assert_eq!(latest(&store, &key("other")), None);
    }
}
