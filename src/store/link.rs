//! Files shown at a second place: by hard link; where that cannot be, by reflink; else by copy.

use std::fs;
use std::path::Path;
use std::time::SystemTime;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};
use walkdir::WalkDir;

use super::Store;
use super::error::{At, StoreError};
use super::index::Signature;
use super::result::{Output, StoredFile};

impl Store {
    /// Shows an artifact as a folder. What is there and as it should be is left alone; anything else there is removed.
    pub fn show(&self, output: &Output, folder: &Path) -> Result<(), StoreError> {
        if self.shows(output, folder) {
            return Ok(());
        }
        self.clear(folder)?;
        for file in &output.files {
            let path = folder.join(&file.path);
            let parent = super::parent(&path);
            self.disk.create_folders(parent).at("create", parent)?;
            self.disk.link(&self.blob_path(&file.blob), &path).at("write", &path)?;
        }
        self.disk.create_folders(folder).at("create", folder)
    }

    fn shows(&self, output: &Output, folder: &Path) -> bool {
        self.showed(output, folder).unwrap_or_else(|| {
            let now = SystemTime::now();
            let seen = Shown::new(output, folder);
            let files = WalkDir::new(folder).into_iter().flatten().filter(|entry| !entry.file_type().is_dir()).count();
            let shows = folder.is_dir()
                && files == output.files.len()
                && output.files.iter().all(|file| self.shows_file(file, folder));
            if let Some(seen) = seen.filter(|seen| shows && seen.is_settled(now)) {
                self.index.put(&name(folder), &seen);
            }
            shows
        })
    }

    /// Whether a folder was found to show an artifact at an earlier time and has not changed since; `None` where that is not known.
    fn showed(&self, output: &Output, folder: &Path) -> Option<bool> {
        let seen: Shown = self.index.get(&name(folder))?;
        (Shown::new(output, folder)? == seen).then_some(true)
    }

    fn shows_file(&self, file: &StoredFile, folder: &Path) -> bool {
        let (shown, blob) = (folder.join(&file.path), self.blob_path(&file.blob));
        same_file(&shown, &blob) || super::blob::digest_file(&shown).is_ok_and(|(digest, _)| digest == file.blob)
    }
}

/// What the index remembers of a folder that shows an artifact.
#[derive(PartialEq, Serialize, Deserialize)]
struct Shown {
    /// The blobs.
    blobs: Vec<Digest>,
    /// Of the folder, then of the files.
    signatures: Vec<Signature>,
}

impl Shown {
    /// As it is now; `None` if something is missing, or the artifact has folders in its folder.
    fn new(output: &Output, folder: &Path) -> Option<Self> {
        let flat = output.files.iter().all(|file| !file.path.contains('/'));
        let paths = std::iter::once(folder.to_owned()).chain(output.files.iter().map(|file| folder.join(&file.path)));
        let signatures = paths.filter(|_| flat).map(|path| Signature::at(&path)).collect::<Option<Vec<_>>>()?;
        Some(Self { blobs: output.files.iter().map(|file| file.blob).collect(), signatures })
    }

    fn is_settled(&self, now: SystemTime) -> bool {
        !self.signatures.is_empty() && self.signatures.iter().all(|signature| signature.is_settled(now))
    }
}

/// The name of a folder in the index.
fn name(folder: &Path) -> Digest {
    let whole = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    blake3::hash(whole.as_os_str().as_encoded_bytes()).into()
}

/// Whether what lies at a path is still what was seen there; links are not followed.
pub fn same_entry(path: &Path, seen: &fs::Metadata) -> bool {
    fs::symlink_metadata(path).is_ok_and(|there| identity(&there) == identity(seen) && there.len() == seen.len())
}

fn same_file(a: &Path, b: &Path) -> bool {
    let pair = (fs::metadata(a), fs::metadata(b));
    matches!(pair, (Ok(a), Ok(b)) if identity(&a).is_some() && identity(&a) == identity(&b))
}

/// What tells a file from all others, whatever its name; `None` where the system does not say.
#[cfg(unix)]
pub fn identity(data: &fs::Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((data.dev(), data.ino()))
}

#[cfg(not(unix))]
pub fn identity(_: &fs::Metadata) -> Option<(u64, u64)> {
    None
}
