//! The store: immutable blobs by digest, results by key. `docs/store.md` has the annotated tree.
//!
//! Nothing half-written is ever visible: everything is written in `work/`, flushed, and renamed into place.
//! Knows nothing of pipelines; a stage is a name, a key and a folder of outputs to it.

pub mod blob;
pub mod error;
pub mod link;
pub mod result;
pub mod runs;
pub mod view;
pub mod work;

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use artifacts_schema::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::key::Manifest;
use error::{At, StoreError};

/// The layout's version.
const VERSION: &str = "1";

/// What tools that make backups look for.
const CACHEDIR_TAG: &str =
    "Signature: 8a477f597d28d172789f06886806bc55\n# Results of srnerf-dag: all can be computed again.\n";

/// A file in `tmp/` that is older than this belongs to no living process.
const LEFT_BEHIND: Duration = Duration::from_secs(3600);

/// A store in a folder.
pub struct Store {
    root: PathBuf,
    /// Blobs that this process has found sound, so that each is read once.
    sound: Mutex<BTreeSet<Digest>>,
}

impl Store {
    /// A store for reading; one that does not exist is empty.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        let store = Self { root: root.to_owned(), sound: Mutex::default() };
        match fs::read_to_string(store.root.join("version")) {
            Ok(version) if version.trim() == VERSION => Ok(store),
            Ok(version) => Err(StoreError::Version { root: store.root, found: version.trim().to_owned() }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(store),
            Err(error) => Err(error).at("read", &store.root.join("version")),
        }
    }

    /// A store for writing; its folders are made where they are missing.
    pub fn create(root: &Path) -> Result<Self, StoreError> {
        let store = Self::open(root)?;
        for folder in ["cas", "results", "manifests", "work", "runs", "quarantine", "tmp"] {
            let folder = store.root.join(folder);
            fs::create_dir_all(&folder).at("create", &folder)?;
        }
        for (name, text) in [("CACHEDIR.TAG", CACHEDIR_TAG), ("version", VERSION)] {
            let path = store.root.join(name);
            if !path.exists() {
                store.put(&path, text.as_bytes())?;
            }
        }
        store.sweep()?;
        Ok(store)
    }

    /// Where a blob lies.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.fanned("cas", digest, "")
    }

    fn result_path(&self, key: &Digest) -> PathBuf {
        self.fanned("results", key, ".json")
    }

    /// The manifest that belongs to a key, if the stage ever ran here.
    pub fn manifest(&self, key: &Digest) -> Option<Manifest> {
        read_json(&self.fanned("manifests", key, ".json")).ok().flatten()
    }

    /// Keeps the manifest of a key.
    pub fn put_manifest(&self, key: &Digest, manifest: &Manifest) -> Result<(), StoreError> {
        let path = self.fanned("manifests", key, ".json");
        if path.exists() { Ok(()) } else { self.put(&path, &json(&path, manifest)?) }
    }

    /// Writes a whole file: in `tmp/`, flushed, then renamed. Replaces what was there.
    fn put(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        self.staged(path, bytes)?.persist(path).map_err(|error| error.error).at("write", path)?;
        flush_folder(parent(path))
    }

    /// The same, unless something is there already: then nothing changes and the answer is false.
    fn put_new(&self, path: &Path, bytes: &[u8]) -> Result<bool, StoreError> {
        match self.staged(path, bytes)?.persist_noclobber(path) {
            Ok(_) => flush_folder(parent(path)).map(|()| true),
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            Err(error) => Err(error.error).at("write", path),
        }
    }

    fn staged(&self, path: &Path, bytes: &[u8]) -> Result<tempfile::NamedTempFile, StoreError> {
        let folder = parent(path);
        fs::create_dir_all(folder).at("create", folder)?;
        let mut file =
            readable_by_all(&mut tempfile::Builder::new()).tempfile_in(self.root.join("tmp")).at("write", path)?;
        file.write_all(bytes).and_then(|()| file.as_file().sync_all()).at("write", path)?;
        Ok(file)
    }

    /// Removes what killed processes left in `tmp/`, where no file is needed for longer than a moment.
    fn sweep(&self) -> Result<(), StoreError> {
        let folder = self.root.join("tmp");
        for entry in fs::read_dir(&folder).at("read", &folder)?.flatten() {
            let age = entry.metadata().and_then(|data| data.modified()).map(|time| time.elapsed().unwrap_or_default());
            if age.is_ok_and(|age| age > LEFT_BEHIND) {
                fs::remove_file(entry.path()).at("remove", &entry.path())?;
            }
        }
        Ok(())
    }

    fn fanned(&self, folder: &str, digest: &Digest, extension: &str) -> PathBuf {
        let name = digest.to_string();
        self.root.join(folder).join(&name[..2]).join(name + extension)
    }
}

fn json(path: &Path, value: &impl Serialize) -> Result<Vec<u8>, StoreError> {
    serde_json::to_vec_pretty(value).map_err(io::Error::from).at("write", path)
}

/// A JSON file's content; `None` where there is no such file or its content is not what it should be.
fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, StoreError> {
    match fs::read(path) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).at("read", path),
    }
}

/// Temporary files are private unless told otherwise, but stores are shared: only the user's own mask shall count.
#[cfg(unix)]
fn readable_by_all<'a, 'p, 's>(builder: &'a mut tempfile::Builder<'p, 's>) -> &'a mut tempfile::Builder<'p, 's> {
    use std::os::unix::fs::PermissionsExt;
    builder.permissions(fs::Permissions::from_mode(0o666))
}

#[cfg(not(unix))]
fn readable_by_all<'a, 'p, 's>(builder: &'a mut tempfile::Builder<'p, 's>) -> &'a mut tempfile::Builder<'p, 's> {
    builder
}

/// Makes a folder's new names survive a crash.
fn flush_folder(folder: &Path) -> Result<(), StoreError> {
    fs::File::open(folder).and_then(|folder| folder.sync_all()).at("flush", folder)
}

fn parent(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("."))
}
