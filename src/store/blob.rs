//! Blobs: read-only files named by the BLAKE3 digest of their bytes. Knows nothing of what is in
//! them.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use artifacts_schema::Digest;

use super::Store;
use super::error::{At, StoreError};

/// What is wrong with a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// It is gone.
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

impl Store {
    /// Moves a finished file into the store. The file must lie on the store's file system, and
    /// nobody may be writing to it.
    pub(super) fn take_blob(&self, file: &Path) -> Result<(Digest, u64), StoreError> {
        // The order is what makes a crash harmless: the file gets its name in `cas/` last, when its
        // bytes are known, on disk and can no longer be written.
        let (digest, bytes) = digest_file(file).at("read", file)?;
        let path = self.blob_path(&digest);
        self.lasting_folder(super::parent(&path))?;
        self.disk.flush(file).at("flush", file)?;
        self.disk.protect(file).at("protect", file)?;
        // Replacing a blob of the same name also heals one that was damaged.
        self.disk.rename(file, &path).at("write", &path)?;
        self.know_sound(digest);
        Ok((digest, bytes))
    }

    /// An empty file in `tmp/` for a blob that comes from elsewhere. It is removed if it is not
    /// kept.
    pub fn receiving(&self) -> Result<tempfile::TempPath, StoreError> {
        let folder = self.root.join("tmp");
        self.disk
            .stage(&folder, &[])
            .and_then(tempfile::TempPath::try_from_path)
            .at("write", &folder)
    }

    /// Moves a received file into the store.
    pub fn keep_received(&self, file: &Path) -> Result<(), StoreError> {
        let (digest, _) = self.take_blob(file)?;
        self.flush_folder(super::parent(&self.blob_path(&digest)))
    }

    /// Reads a blob through, once in this process, and compares it with its name.
    pub fn check_blob(&self, digest: &Digest) -> Result<Option<Damage>, StoreError> {
        // Only what was found sound is remembered. A damaged blob may be healed by another process,
        // and is looked at again.
        if self.sound.lock().is_ok_and(|sound| sound.contains(digest)) {
            return Ok(None);
        }
        let path = self.blob_path(digest);
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
