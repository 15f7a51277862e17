//! The store: immutable blobs by digest, results by key. `docs/store.md` has the annotated tree.
//!
//! Nothing half-written is ever visible: everything is written in `work/` or `tmp/`, flushed, and
//! renamed into place. Knows nothing of pipelines; a stage is a name, a key and a folder of outputs
//! to it.

pub mod blob;
pub mod census;
mod clock;
mod disk;
pub mod error;
pub mod fault;
pub mod fsck;
pub mod gc;
pub mod holder;
mod index;
pub mod lease;
pub mod link;
pub mod manifests;
mod memo;
pub mod pins;
pub mod record;
pub mod result;
pub mod runs;
mod seen;
pub mod signature;
pub mod standing;
pub mod state;
pub mod usage;
pub mod view;
pub mod work;

#[cfg(test)]
mod crash;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime};

use artifacts_schema::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

use clock::Clock;
use disk::Disk;
use error::{At, StoreError};
use index::Index;
use lease::Patience;
use record::Record;

/// The layout's version.
const VERSION: &str = "1";

/// The folders of a store.
const FOLDERS: [&str; 10] = [
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
const FILES: [&str; 5] = ["CACHEDIR.TAG", "version", "lock", "index", "standing"];

/// What tools that make backups look for.
const CACHEDIR_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n# Results of srnerf-dag: all can be computed again.\n";

/// A file in `tmp/` that is older than this belongs to no living process.
const LEFT_BEHIND: Duration = Duration::from_secs(3600);

/// A store in a folder.
pub struct Store {
    root: PathBuf,
    /// Locked for as long as this lives: shared by all who write, or alone. The system unlocks it
    /// when the process dies.
    lock: Option<File>,
    /// Whether the system lets nothing be written.
    read_only: bool,
    /// What earlier processes have found sound.
    index: Index,
    /// Pipelines all of whose results they found there; in a file of its own, which is read first
    /// and by itself.
    standings: Index,
    /// Results that were looked up ahead, each until it is asked for.
    known: Mutex<BTreeMap<Digest, Record>>,
    /// Blobs that this process has read and found sound, so that each is read once.
    sound: Mutex<BTreeSet<Digest>>,
    disk: Disk,
    clock: Clock,
    patience: Patience,
    /// When each lease of others was last touched, and since when we have seen that.
    seen: Mutex<BTreeMap<PathBuf, (SystemTime, Instant)>>,
}

impl Store {
    /// A store for reading; one that does not exist is empty.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_on(Disk::default(), root)
    }

    fn open_on(disk: Disk, root: &Path) -> Result<Self, StoreError> {
        let [index, standings] = ["index", "standing"].map(|name| Index::new(root.join(name)));
        let store = Self {
            root: root.to_owned(),
            lock: None,
            read_only: false,
            index,
            standings,
            known: Mutex::default(),
            sound: Mutex::default(),
            disk,
            clock: Clock::default(),
            patience: Patience::default(),
            seen: Mutex::default(),
        };
        match fs::read_to_string(store.root.join("version")) {
            Ok(version) if version.trim() == VERSION => Ok(store),
            Ok(version) => Err(StoreError::Version {
                root: store.root,
                found: version.trim().to_owned(),
            }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(store),
            Err(error) => Err(error).at("read", &store.root.join("version")),
        }
    }

    /// A store for writing; its folders are made where they are missing. One that is there and can
    /// only be read will do for a run that has nothing to compute.
    pub fn create(root: &Path) -> Result<Self, StoreError> {
        Self::create_on(Disk::default(), root)
    }

    fn create_on(disk: Disk, root: &Path) -> Result<Self, StoreError> {
        let mut store = Self::open_on(disk, root)?;
        match store.prepare() {
            // `version` is written last: where it is, a whole store was made, which can be read.
            Err(error) if error.is_refusal() && root.join("version").exists() => {
                store.read_only = true
            }
            prepared => prepared?,
        }
        Ok(store)
    }

    fn prepare(&mut self) -> Result<(), StoreError> {
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
        self.sweep()?;
        self.share()
    }

    /// Keeps others from removing what this process may need. A file system without locks takes it
    /// as it is.
    fn share(&mut self) -> Result<(), StoreError> {
        let file = self.lock_file()?;
        // This waits for a `gc` that removes things just now. An error means that the file system
        // has no locks; then the age of blobs is what protects a run (docs/store.md, Garbage).
        let _ = file.lock_shared();
        self.lock = Some(file);
        Ok(())
    }

    /// The same, for who only reads: where there is a store and it can be locked.
    pub fn share_if_there(&mut self) {
        // Reading is enough for a shared lock, so that a store which cannot be written is protected
        // too.
        self.lock = File::open(self.root.join("lock")).ok();
        let _ = self.lock.iter().try_for_each(File::lock_shared);
    }

    /// Keeps everyone else from using the store; an error if anyone does.
    pub fn alone(&mut self) -> Result<(), StoreError> {
        let file = self.lock_file()?;
        // It does not wait: runs last for hours, and whoever cleans up can come back.
        match file.try_lock() {
            Ok(()) => self.lock = Some(file),
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::InUse {
                    root: self.root.clone(),
                });
            }
            Err(TryLockError::Error(error)) => {
                return Err(error).at("lock", &self.root.join("lock"));
            }
        }
        // Another host's locks may not show here, but its leases do.
        if self.has_leases()? {
            Err(StoreError::InUse {
                root: self.root.clone(),
            })
        } else {
            Ok(())
        }
    }

    /// Keeps what was found for later processes.
    fn keep_index(&self) {
        self.index.keep(|path, bytes| drop(self.put(path, bytes)));
    }

    fn lock_file(&self) -> Result<File, StoreError> {
        let path = self.root.join("lock");
        File::options()
            .create(true)
            .append(true)
            .open(&path)
            .at("open", &path)
    }

    /// Where a blob lies.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.fanned("cas", digest, "")
    }

    fn result_path(&self, key: &Digest) -> PathBuf {
        self.fanned("results", key, ".json")
    }

    /// Writes a whole file: in `tmp/`, flushed, then renamed. Replaces what was there.
    fn put(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        // Readers see the old file or the new one, and never a part: the bytes are on disk before
        // the name is.
        let staged = self.staged(path, bytes)?;
        self.disk.rename(&staged, path).at("write", path)?;
        self.flush_folder(parent(path))
    }

    /// The same, unless something is there already: then nothing changes and the answer is false.
    fn put_new(&self, path: &Path, bytes: &[u8]) -> Result<bool, StoreError> {
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
    fn lasting_folder(&self, folder: &Path) -> Result<(), StoreError> {
        if folder.is_dir() {
            return Ok(());
        }
        self.disk.create_folders(folder).at("create", folder)?;
        self.flush_folder(parent(folder))
    }

    /// Makes a folder's new names survive a loss of power.
    fn flush_folder(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.flush(folder).at("flush", folder)
    }

    /// Removes a folder, if there is one.
    pub fn clear(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.remove_folder(folder).at("remove", folder)
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

    fn fanned(&self, folder: &str, digest: &Digest, extension: &str) -> PathBuf {
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

fn json(path: &Path, value: &impl Serialize) -> Result<Vec<u8>, StoreError> {
    serde_json::to_vec_pretty(value)
        .map_err(io::Error::from)
        .at("write", path)
}

/// A JSON file's content; `None` where there is no such file, or something that is not what it
/// should be.
fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, StoreError> {
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

fn parent(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("."))
}
