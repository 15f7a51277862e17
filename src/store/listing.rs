//! What lies in a store, read once, and what results refer to: the ground of `fsck`, `gc` and `du`.
//! Judges nothing.

use std::collections::BTreeMap;
use std::fs::{self, Metadata};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use artifacts_schema::Digest;

use super::error::{At, StoreError};
use super::files::Files;
use super::record::{Record, StoredFile};

/// Something in a folder of a store.
pub struct Entry {
    pub path: PathBuf,
    /// What the system says of it; of a link, not of what it leads to.
    pub data: Metadata,
}

impl Entry {
    /// What it is, if it is no file.
    pub fn wrong_type(&self) -> Option<&'static str> {
        let kind = self.data.file_type();
        match () {
            // Of the entry itself: a link counts as a link, whatever it leads to.
            () if kind.is_file() => None,
            () if kind.is_dir() => Some("folder"),
            () if kind.is_symlink() => Some("link"),
            () => Some("special file"),
        }
    }

    /// Whether it was certainly left alone for so long.
    pub fn is_older(&self, than: Duration) -> bool {
        age(&self.data).is_some_and(|age| age > than)
    }

    /// The digest that is its name, whatever the extension.
    pub fn digest(&self) -> Option<Digest> {
        self.path.file_stem()?.to_str()?.parse().ok()
    }
}

/// The blobs that results refer to, with the size and an example of whose each is: `fit:
/// field/field.safetensors`.
pub type References = BTreeMap<Digest, (u64, String)>;

/// What results refer to.
pub fn references<'r>(records: impl Iterator<Item = &'r Record>) -> References {
    let mut references = References::new();
    for record in records {
        for (output, file) in record.files() {
            references
                .entry(file.blob)
                .or_insert_with(|| (file.bytes, label(record, output, file)));
        }
    }
    references
}

/// The artifacts that results hold, by the digest of their content, with an example of which output
/// of which stage each is.
pub type Producers = BTreeMap<Digest, String>;

/// Who gave which artifacts.
pub fn producers(records: &[Record]) -> Producers {
    let mut producers = Producers::new();
    for record in records {
        for (name, output) in &record.outputs {
            producers
                .entry(output.digest)
                .or_insert_with(|| format!("{}.{name}", record.stage));
        }
    }
    producers
}

/// `fit: field/field.safetensors`.
pub fn label(record: &Record, output: &str, file: &StoredFile) -> String {
    format!("{}: {output}/{}", record.stage, file.path)
}

impl Files {
    /// What lies in one of the store's folders, in order; nothing where there is no such folder.
    pub(super) fn entries(&self, folder: &str) -> Result<Vec<Entry>, StoreError> {
        list(&self.root.join(folder))
    }

    /// What lies in the folders `00` to `ff` of one of the store's folders, and what lies there in
    /// place of them.
    pub(super) fn fanned_entries(
        &self,
        folder: &str,
    ) -> Result<(Vec<Entry>, Vec<Entry>), StoreError> {
        let (folders, strays): (Vec<_>, Vec<_>) = self
            .entries(folder)?
            .into_iter()
            .partition(|entry| entry.data.is_dir() && is_fan(&entry.path));
        let mut files = Vec::new();
        for folder in folders {
            files.extend(list(&folder.path)?);
        }
        Ok((files, strays))
    }
}

/// How long ago something was changed; `None` if that cannot be told.
pub(super) fn age(data: &Metadata) -> Option<Duration> {
    // A time in the future, by a clock that was set back, gives no age.
    SystemTime::now().duration_since(data.modified().ok()?).ok()
}

fn is_fan(path: &Path) -> bool {
    let name = path
        .file_name()
        .and_then(|name| name.to_str())
        .unwrap_or_default();
    name.len() == 2
        && name
            .bytes()
            // In lower case alone, as digests are written.
            .all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

pub(super) fn list(folder: &Path) -> Result<Vec<Entry>, StoreError> {
    // A store that was never written to has no folders, and is empty.
    let found = match fs::read_dir(folder) {
        Ok(found) => found,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).at("read", folder),
    };
    let mut entries = Vec::new();
    for entry in found {
        let path = entry.at("read", folder)?.path();
        match fs::symlink_metadata(&path) {
            Ok(data) => entries.push(Entry { path, data }),
            // Another process took it away meanwhile.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error).at("read", &path),
        }
    }
    // File systems list names in any order. Sorted, what is printed and done is the same each time.
    entries.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(entries)
}
