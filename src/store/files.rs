//! The files of a store: its folder, the names in it, and how they are written so that they last.
//! Knows nothing of what is in them.
//!
//! Nothing half-written is ever visible: everything is written in `work/` or `tmp/`, flushed, and
//! renamed into place.

pub(super) mod disk;
pub(super) mod identity;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use artifacts_schema::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{At, StoreError};
use disk::Disk;

pub(super) const VERSION: &str = "1";

/// The folders of a store.
pub(super) const FOLDERS: [&str; 10] = [
    "cas",
    "results",
    "manifests",
    "work",
    "states",
    "leases",
    "runs",
    "pins",
    "quarantine",
    "tmp",
];

/// The files in a store's root.
pub(super) const FILES: [&str; 5] = ["CACHEDIR.TAG", "version", "lock", "index", "standing"];

/// What tools that make backups look for.
const CACHEDIR_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n# Results of srnerf-dag: all can be computed again.\n";

/// A file in `tmp/` that is older than this belongs to no living process.
const LEFT_BEHIND: Duration = Duration::from_secs(3600);

/// The files of one store.
pub struct Files {
    pub(super) root: PathBuf,
    pub(super) disk: Disk,
    /// Whether the system lets nothing be written.
    pub(super) read_only: bool,
}

impl Files {
    /// Those in a folder, which need not be there; an error if they are laid out in another way.
    pub(super) fn open(disk: Disk, root: &Path) -> Result<Self, StoreError> {
        let files = Self {
            root: root.to_owned(),
            disk,
            read_only: false,
        };
        match fs::read_to_string(files.root.join("version")) {
            Ok(version) if version.trim() == VERSION => Ok(files),
            Ok(version) => Err(StoreError::Version {
                root: files.root,
                found: version.trim().to_owned(),
            }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(files),
            Err(error) => Err(error).at("read", &files.root.join("version")),
        }
    }

    /// Makes what is missing, and removes what others have left on its way.
    pub(super) fn prepare(&self) -> Result<(), StoreError> {
        for folder in FOLDERS {
            let folder = self.root.join(folder);
            self.disk.create_folders(&folder).at("create", &folder)?;
        }
        // Only the first two are written here, since `zip` ends with the texts. The others come
        // into being when they are first used.
        for (name, text) in FILES.iter().zip([CACHEDIR_TAG, VERSION]) {
            let path = self.root.join(name);
            if !path.exists() {
                self.put(&path, text.as_bytes())?;
            }
        }
        self.sweep()
    }

    /// Writes a whole file: in `tmp/`, flushed, then renamed. Replaces what was there.
    pub(super) fn put(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        // Readers see the old file or the new one, and never a part: the bytes are on disk before
        // the name is.
        let staged = self.staged(path, bytes)?;
        self.disk.rename(&staged, path).at("write", path)?;
        self.flush_folder(parent(path))
    }

    /// The same, unless something is there already: then nothing changes and the answer is false.
    pub(super) fn put_new(&self, path: &Path, bytes: &[u8]) -> Result<bool, StoreError> {
        let staged = self.staged(path, bytes)?;
        // Looking first and renaming then would let two processes both find the place free.
        match self.disk.rename_new(&staged, path) {
            Ok(()) => self.flush_folder(parent(path)).map(|()| true),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            Err(error) => Err(error).at("write", path),
        }
    }

    fn staged(&self, path: &Path, bytes: &[u8]) -> Result<PathBuf, StoreError> {
        self.lasting_folder(parent(path))?;
        self.disk
            .stage(&self.root.join("tmp"), bytes)
            .at("write", path)
    }

    /// Makes a folder, whose name is to last as long as the names in it.
    pub(super) fn lasting_folder(&self, folder: &Path) -> Result<(), StoreError> {
        if folder.is_dir() {
            return Ok(());
        }
        self.disk.create_folders(folder).at("create", folder)?;
        self.flush_folder(parent(folder))
    }

    /// Makes a folder's new names survive a loss of power.
    pub(super) fn flush_folder(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.flush(folder).at("flush", folder)
    }

    /// Removes a folder, if there is one.
    pub(super) fn clear(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.remove_folder(folder).at("remove", folder)
    }

    /// Puts something out of reach, for whoever wants to look into it. It may be gone already.
    pub(super) fn set_aside(&self, path: &Path) -> Result<(), StoreError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let place = |number: u32| {
            let name = if number == 0 {
                name.to_string()
            } else {
                format!("{name}-{number}")
            };
            self.root.join("quarantine").join(name)
        };
        // What was put there earlier under the same name is kept: it may be the only trace of what
        // goes wrong.
        let free = (0..)
            .map(place)
            .find(|place| fs::symlink_metadata(place).is_err());
        match self.disk.rename(path, &free.unwrap_or_else(|| place(0))) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(error).at("move to quarantine", path)
            }
            _ => Ok(()),
        }
    }

    /// Removes what killed processes left in `tmp/`, where no file is needed for longer than a
    /// moment.
    fn sweep(&self) -> Result<(), StoreError> {
        let folder = self.root.join("tmp");
        // A process that is alive may have files here, so age decides. A clock that was set back
        // makes them young, and they stay for the next time.
        for entry in fs::read_dir(&folder).at("read", &folder)?.flatten() {
            let age = entry
                .metadata()
                .and_then(|data| data.modified())
                .map(|time| time.elapsed().unwrap_or_default());
            if age.is_ok_and(|age| age > LEFT_BEHIND) {
                self.disk
                    .remove_file(&entry.path())
                    .at("remove", &entry.path())?;
            }
        }
        Ok(())
    }

    /// Where a thing of this name lies.
    pub(super) fn fanned(&self, folder: &str, digest: &Digest, extension: &str) -> PathBuf {
        // Thousands of these are made in a plan: one allocation each.
        let mut path = PathBuf::with_capacity(self.root.as_os_str().len() + 96);
        path.push(&self.root);
        path.push(place(folder, digest, extension));
        path
    }
}

/// Where a thing of this name lies in a store, here or elsewhere: `cas/3f/3f9a..`.
pub fn place(folder: &str, digest: &Digest, extension: &str) -> String {
    let name = digest.to_string();
    // Two digits in between keep folders small: some file systems are slow with a hundred thousand
    // names in one.
    [folder, "/", &name[..2], "/", &name, extension].concat()
}

/// What a JSON file says, in bytes.
pub(super) fn json(path: &Path, value: &impl Serialize) -> Result<Vec<u8>, StoreError> {
    serde_json::to_vec_pretty(value)
        .map_err(io::Error::from)
        .at("write", path)
}

/// A JSON file's content; `None` where there is no such file, or something that is not what it
/// should be.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, StoreError> {
    match fs::read(path) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        // What may not be read is not damaged: computing it again would help nobody, so the user is
        // told.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            Err(error).at("read", path)
        }
        Err(_) => Ok(None),
    }
}

/// The folder that something lies in.
pub(super) fn parent(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests;
