//! Blobs: read-only files named by the BLAKE3 digest of their bytes. Knows nothing of what is in
//! them.

use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use artifacts_schema::Digest;

use super::error::{At, StoreError};
use super::files::{Files, parent};

/// What is wrong with a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    Missing,
    /// Its bytes are not those of its name.
    Changed,
}

/// The digest and size of a file's bytes.
pub fn digest_file(path: &Path) -> std::io::Result<(Digest, u64)> {
    let mut hasher = blake3::Hasher::new();
    // By all threads, from mapped memory: nobody shortens a blob.
    hasher.update_mmap_rayon(path)?;
    Ok((hasher.finalize().into(), hasher.count()))
}

/// The blobs of a store.
pub struct Blobs {
    files: Arc<Files>,
    /// Those that this process has read and found sound, so that each is read once.
    sound: Mutex<BTreeSet<Digest>>,
}

impl Blobs {
    pub(super) fn new(files: Arc<Files>) -> Self {
        Self {
            files,
            sound: Mutex::default(),
        }
    }

    /// Where a blob lies.
    pub fn path(&self, digest: &Digest) -> PathBuf {
        self.files.fanned("cas", digest, "")
    }

    /// Moves a finished file into the store. The file must lie on the store's file system, and
    /// nobody may be writing to it.
    pub(super) fn take(&self, file: &Path) -> Result<(Digest, u64), StoreError> {
        // The order is what makes a crash harmless: the file gets its name in `cas/` last, when its
        // bytes are known, on disk and can no longer be written.
        let (digest, bytes) = digest_file(file).at("read", file)?;
        let path = self.path(&digest);
        self.files.lasting_folder(parent(&path))?;
        self.files.disk.flush(file).at("flush", file)?;
        self.files.disk.protect(file).at("protect", file)?;
        // Replacing a blob of the same name also heals one that was damaged.
        self.files.disk.rename(file, &path).at("write", &path)?;
        self.know_sound(digest);
        Ok((digest, bytes))
    }

    /// An empty file in `tmp/` for a blob that comes from elsewhere. It is removed if it is not
    /// kept.
    pub fn receiving(&self) -> Result<tempfile::TempPath, StoreError> {
        let folder = self.files.root.join("tmp");
        self.files
            .disk
            .stage(&folder, &[])
            .and_then(tempfile::TempPath::try_from_path)
            .at("write", &folder)
    }

    /// Moves a received file into the store.
    pub fn keep(&self, file: &Path) -> Result<(), StoreError> {
        let (digest, _) = self.take(file)?;
        self.files.flush_folder(parent(&self.path(&digest)))
    }

    /// Reads a blob through, once in this process, and compares it with its name.
    pub fn check(&self, digest: &Digest) -> Result<Option<Damage>, StoreError> {
        // Only what was found sound is remembered. A damaged blob may be healed by another process,
        // and is looked at again.
        if self.sound.lock().is_ok_and(|sound| sound.contains(digest)) {
            return Ok(None);
        }
        let path = self.path(digest);
        let damage = match digest_file(&path) {
            Ok((found, _)) if found == *digest => {
                self.know_sound(*digest);
                return Ok(None);
            }
            Ok(_) => Damage::Changed,
            // A blob that may not be read is not known to be damaged, and must not be put into
            // quarantine.
            Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                return Err(error).at("read", &path);
            }
            Err(_) if fs::symlink_metadata(&path).is_err() => Damage::Missing,
            // A folder, or a link that leads nowhere, is in its place; or the disk is failing.
            Err(_) => Damage::Changed,
        };
        Ok(Some(damage))
    }

    fn know_sound(&self, digest: Digest) {
        if let Ok(mut sound) = self.sound.lock() {
            sound.insert(digest);
        }
    }
}
