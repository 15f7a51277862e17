//! Files shown at a second place: by hard link, or by copy where the file system has none.

use std::fs;
use std::path::Path;

use super::Store;
use super::error::{At, StoreError};
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
        let there =
            walkdir::WalkDir::new(folder).into_iter().flatten().filter(|entry| !entry.file_type().is_dir()).count();
        folder.is_dir() && there == output.files.len() && output.files.iter().all(|file| self.shows_file(file, folder))
    }

    fn shows_file(&self, file: &StoredFile, folder: &Path) -> bool {
        let (shown, blob) = (folder.join(&file.path), self.blob_path(&file.blob));
        same_file(&shown, &blob) || super::blob::digest_file(&shown).is_ok_and(|(digest, _)| digest == file.blob)
    }
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
