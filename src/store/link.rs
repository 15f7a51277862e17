//! Files shown at a second place: by hard link; where that cannot be, by reflink; else by copy.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::{Duration, SystemTime};

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};
use walkdir::WalkDir;

use super::Store;
use super::blobs::digest_file;
use super::cache::index::Kind;
use super::cache::signature::Signature;
use super::error::{At, StoreError};
use super::files::identity::same_file;
use super::files::parent;
use super::record::{Output, StoredFile};

/// How often to try again to show a folder that another process shows at the same time.
const MOST_ATTEMPTS: u64 = 32;

impl Output {
    /// Shows an artifact as a folder. What is there and as it should be is left alone; anything
    /// else there is removed.
    pub fn show(&self, store: &Store, folder: &Path) -> Result<(), StoreError> {
        for attempt in 0..MOST_ATTEMPTS {
            if self.is_shown(store, folder) {
                return Ok(());
            }
            match self.place(store, folder) {
                // Another process shows the same here, and each clears away what the other has:
                // they wait for different times, so that one of them comes to its end.
                Err(error) if error.is_of_a_race() => {
                    let turn = u64::from(std::process::id()) % 8;
                    std::thread::sleep(Duration::from_millis(attempt + turn));
                }
                other => return other,
            }
        }
        // Whatever goes wrong this time is said: after so many attempts it is no race any more.
        self.place(store, folder)
    }

    fn place(&self, store: &Store, folder: &Path) -> Result<(), StoreError> {
        // Files of an earlier result would otherwise stay, and be taken for some of this one.
        store.files.clear(folder)?;
        for file in &self.files {
            let path = folder.join(&file.path);
            let parent = parent(&path);
            store
                .files
                .disk
                .create_folders(parent)
                .at("create", parent)?;
            store
                .files
                .disk
                .link(&store.blobs.path(&file.blob), &path)
                .at("write", &path)?;
        }
        // An artifact without files is an empty folder, which the loop above does not make.
        store.files.disk.create_folders(folder).at("create", folder)
    }

    fn is_shown(&self, store: &Store, folder: &Path) -> bool {
        let name = name(folder);
        let seen = store.cache.index.get(Kind::Shown, &name);
        if seen.is_some_and(|seen: Shown| seen.stands(self, folder)) {
            return true;
        }
        // Before the files are compared, for the same reason as in `lookup`: what changes meanwhile
        // is not remembered.
        let now = store.cache.clock.now();
        let seen = Shown::new(self, folder);
        // A file too many is as wrong as one too few: whoever lists the folder would take it for a
        // part of the artifact.
        let files = WalkDir::new(folder)
            .into_iter()
            .flatten()
            .filter(|entry| !entry.file_type().is_dir())
            .count();
        let shows = folder.is_dir()
            && files == self.files.len()
            && self.files.iter().all(|file| is_shown(file, store, folder));
        if let Some(seen) = seen.filter(|seen| shows && seen.is_settled(now)) {
            store.cache.index.put(Kind::Shown, &name, &seen);
        }
        shows
    }
}

/// What the index remembers of a folder that shows an artifact.
#[derive(Serialize, Deserialize)]
struct Shown {
    folder: Signature,
    /// Of the files, as one sees them in the folder.
    files: Vec<Signature>,
    blobs: Vec<Digest>,
}

impl Shown {
    /// As it is now; `None` if something is missing, or the artifact has folders in its folder.
    fn new(output: &Output, folder: &Path) -> Option<Self> {
        // A folder's signature says nothing of the folders in it, so only a flat one can be
        // remembered by it.
        let flat = output.files.iter().all(|file| !file.path.contains('/'));
        let files = output
            .files
            .iter()
            .filter(|_| flat)
            .map(|file| Signature::at(&folder.join(&file.path)));
        let files = files.collect::<Option<Vec<_>>>()?;
        let folder = Signature::at(folder).filter(|_| flat)?;
        Some(Self {
            folder,
            files,
            blobs: output.files.iter().map(|file| file.blob).collect(),
        })
    }

    /// Whether a folder that was found to show an artifact at an earlier time has not changed
    /// since. Of a blob's second name, it is enough that the folder still has it and that the blob
    /// is as it was.
    fn stands(&self, output: &Output, folder: &Path) -> bool {
        let is_same = |(file, before): (&StoredFile, &Signature)| {
            // A second name has the signature of its blob, at which a lookup has just looked.
            file.last_signature.0.as_ref() == Some(before)
                || Signature::at(&folder.join(&file.path)).as_ref() == Some(before)
        };
        self.blobs
            .iter()
            .eq(output.files.iter().map(|file| &file.blob))
            && Signature::at(folder) == Some(self.folder)
            && output.files.iter().zip(&self.files).all(is_same)
    }

    fn is_settled(&self, now: SystemTime) -> bool {
        self.files
            .iter()
            .chain([&self.folder])
            .all(|signature| signature.is_settled(now))
    }
}

/// The folder that relative paths start from, which this program never changes.
static HERE: LazyLock<PathBuf> = LazyLock::new(|| std::env::current_dir().unwrap_or_default());

/// The name of a folder in the index.
fn name(folder: &Path) -> Digest {
    blake3::hash(HERE.join(folder).as_os_str().as_encoded_bytes()).into()
}

/// Whether a folder shows a file as it is in the store.
fn is_shown(file: &StoredFile, store: &Store, folder: &Path) -> bool {
    let shown = folder.join(&file.path);
    let blob = store.blobs.path(&file.blob);
    // A second name need not be read. A copy can only be told by its bytes.
    same_file(&shown, &blob) || digest_file(&shown).is_ok_and(|(digest, _)| digest == file.blob)
}
