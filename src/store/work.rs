//! The private folder in which one stage runs, and the commit that turns what it wrote into a result.
//!
//! `work/<key>/in` shows its inputs, `out` takes its outputs, `scratch` outlives an interrupted run: the place for checkpoints.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use artifacts_schema::{ArtifactKind, Digest, semantic_digest};
use walkdir::WalkDir;

use super::error::{At, StoreError};
use super::link::clear;
use super::result::{Output, Record, StoredFile};
use super::{Store, flush_folder, parent};

/// The private folder of one key. Only one process at a time has it.
pub struct Work<'s> {
    store: &'s Store,
    key: Digest,
    folder: PathBuf,
    /// Locked for as long as this lives; the system unlocks it when the process dies, however it dies.
    _lock: File,
}

/// What a commit says of a stage beside its outputs.
pub struct Facts {
    /// The stage's name.
    pub stage: String,
    /// How long it took.
    pub seconds: f64,
    /// The kind of device that it ran on.
    pub device: String,
}

impl Store {
    /// The private folder of a key, with empty `in` and `out`; `None` while another process has it.
    pub fn work(&self, key: Digest) -> Result<Option<Work<'_>>, StoreError> {
        let folder = self.root.join("work").join(key.to_string());
        let lock_path = folder.with_extension("lock");
        let lock = File::create(&lock_path).at("create", &lock_path)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) => return Err(error).at("lock", &lock_path),
        }
        // The one who had it before may have removed the file while we waited at its door.
        if !super::link::is_still_at(&lock, &lock_path) {
            return Ok(None);
        }
        let work = Work { store: self, key, folder, _lock: lock };
        clear(&work.folder.join("in"))?;
        clear(&work.outputs())?;
        for folder in [work.outputs(), work.scratch()] {
            fs::create_dir_all(&folder).at("create", &folder)?;
        }
        Ok(Some(work))
    }
}

impl Work<'_> {
    /// Where the stage writes its outputs.
    pub fn outputs(&self) -> PathBuf {
        self.folder.join("out")
    }

    /// What is kept until the result is committed.
    pub fn scratch(&self) -> PathBuf {
        self.folder.join("scratch")
    }

    /// Shows an input artifact to the stage, and says where.
    pub fn input(&self, name: &str, artifact: &Output) -> Result<PathBuf, StoreError> {
        let folder = self.folder.join("in").join(name);
        self.store.show(artifact, &folder)?;
        Ok(folder)
    }

    /// Turns what the stage wrote into a result: blobs, flushed, then the record. `replace` overrules an earlier result.
    pub fn commit(self, outputs: &[(&str, ArtifactKind)], facts: Facts, replace: bool) -> Result<Record, StoreError> {
        let mut kept = BTreeMap::new();
        for (name, kind) in outputs {
            kept.insert((*name).to_owned(), self.keep(name, *kind)?);
        }
        for folder in kept.values().flat_map(|output| &output.files).map(|file| self.store.blob_path(&file.blob)) {
            flush_folder(parent(&folder))?;
        }
        let Facts { stage, seconds, device } = facts;
        let record = Record { key: self.key, stage, outputs: kept, seconds, device };
        let record = self.store.put_result(record, replace)?;
        clear(&self.folder)?;
        self.unlock()?;
        Ok(record)
    }

    /// Gives the folder up without a result; scratch stays if there is anything in it.
    pub fn abandon(self) -> Result<(), StoreError> {
        clear(&self.folder.join("in"))?;
        clear(&self.outputs())?;
        // Both fail, as they should, while there is something in the folder.
        let _ = fs::remove_dir(self.scratch());
        let _ = fs::remove_dir(&self.folder);
        self.unlock()
    }

    fn unlock(self) -> Result<(), StoreError> {
        let lock = self.folder.with_extension("lock");
        fs::remove_file(&lock).at("remove", &lock)
    }

    fn keep(&self, name: &str, kind: ArtifactKind) -> Result<Output, StoreError> {
        let folder = self.outputs().join(name);
        let refused = |problem: String| StoreError::Output { output: name.to_owned(), problem };
        let digest = semantic_digest(kind, &folder).map_err(|error| refused(error.to_string()))?;
        let mut files = Vec::new();
        for entry in WalkDir::new(&folder).sort_by_file_name() {
            let entry = entry.map_err(|error| refused(error.to_string()))?;
            if !entry.file_type().is_dir() {
                let path =
                    relative(entry.path(), &folder).ok_or_else(|| refused("a file's name is not text".into()))?;
                let (blob, bytes) = self.store.take_blob(entry.path())?;
                files.push(StoredFile { path, blob, bytes });
            }
        }
        Ok(Output { kind, digest, files })
    }
}

/// A path inside a folder, with `/` on every system.
fn relative(path: &Path, folder: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = path.strip_prefix(folder).ok()?.iter().map(|part| part.to_str()).collect();
    parts.map(|parts| parts.join("/"))
}
