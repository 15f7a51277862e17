//! The private folder in which one stage runs, and the commit that turns what it wrote into a
//! result.
//!
//! In `work/<key>`, `run-<nonce>` belongs to one lease: `in` shows the stage's inputs, `out` takes
//! its outputs. `scratch` is the key's own, and outlives an interrupted run: the place for
//! checkpoints.

use std::collections::BTreeMap;
use std::fs;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};

use artifacts_schema::{ArtifactKind, Digest, semantic_digest};
use walkdir::WalkDir;

use super::cache::signature::Signature;
use super::error::{At, StoreError};
use super::files::parent;
use super::leases::Claim;
use super::leases::holder::Holder;
use super::leases::lease::Lease;
use super::record::{LastSignature, Output, Record, StoredFile};
use super::{Store, state};

/// The private folder of one key. Only one process at a time has it.
pub struct Work<'s> {
    store: &'s Store,
    key: Digest,
    folder: PathBuf,
    /// The folder of this lease.
    run: PathBuf,
    lease: Lease<'s>,
}

/// What a commit says of a stage beside its outputs.
pub struct Facts {
    /// The stage's name.
    pub stage: String,
    /// How long it took.
    pub seconds: f64,
    /// The kind of device that it ran on.
    pub device: String,
    /// What whoever uses the result should know.
    pub remarks: Vec<String>,
    /// The most memory that the program had while it ran, in bytes, where the system tells.
    pub peak_memory: Option<u64>,
}

impl<'s> Work<'s> {
    /// The private folder of a key, with empty `in` and `out`; else the process that has it.
    pub fn begin(store: &'s Store, key: Digest) -> Result<Result<Self, Holder>, StoreError> {
        let lease = match store.leases.take(&key)? {
            Claim::Ours(lease) => lease,
            Claim::Theirs(holder) => return Ok(Err(holder)),
        };
        let folder = store.files.root.join("work").join(key.to_string());
        // The nonce comes from the system's random numbers. Process numbers repeat on other hosts,
        // and clocks can be set back.
        let run = folder.join(format!(
            "run-{:016x}",
            RandomState::new().build_hasher().finish()
        ));
        let work = Self {
            store,
            key,
            folder,
            run,
            lease,
        };
        // The lease is ours by now, so whoever made these folders is dead or has lost it.
        work.sweep()?;
        for folder in [work.outputs(), work.scratch()] {
            store
                .files
                .disk
                .create_folders(&folder)
                .at("create", &folder)?;
        }
        Ok(Ok(work))
    }

    /// Where the stage writes its outputs.
    pub fn outputs(&self) -> PathBuf {
        self.run.join("out")
    }

    /// What is kept until the result is committed.
    pub fn scratch(&self) -> PathBuf {
        self.folder.join("scratch")
    }

    /// Goes on from the checkpoint that a stage left under another key, unless it has one of its
    /// own. Where it cannot be had, the stage begins with its first step.
    pub fn take_over(&self, other: &Digest) {
        let scratch = self
            .store
            .files
            .root
            .join("work")
            .join(other.to_string())
            .join("scratch");
        let [from, to] =
            [scratch, self.scratch()].map(|folder| folder.join(stages::checkpointer::FILE));
        // Copied, not moved: a later run on the GPU can still go on from it.
        if !to.exists() {
            // Under another name until it is whole: one cut short would not be copied again.
            let partial = to.with_extension("part");
            // Without it the stage takes longer, and comes to its result all the same.
            let _ = fs::copy(from, &partial).and_then(|_| fs::rename(&partial, to));
        }
    }

    /// Whether another process has taken the key over, so that nothing done here counts.
    pub fn is_lost(&self) -> bool {
        self.lease.is_lost()
    }

    /// The process that has, after looking.
    pub fn lost_to(&self) -> Option<Holder> {
        self.lease.lost_to()
    }

    /// Shows an input artifact to the stage, and says where.
    pub fn input(&self, name: &str, artifact: &Output) -> Result<PathBuf, StoreError> {
        let folder = self.run.join("in").join(name);
        artifact.show(self.store, &folder)?;
        Ok(folder)
    }

    /// Keeps the last checkpoint, if there is one, for longer runs to go on from.
    pub fn keep_state(&self, extension: &Digest) -> Result<(), StoreError> {
        let checkpoint = self.scratch().join(stages::checkpointer::FILE);
        if checkpoint.exists() {
            state::keep(self.store, extension, &self.key, &checkpoint)
        } else {
            Ok(())
        }
    }

    /// Removes what runs that were killed, and those that lost their lease, have left or still
    /// write to.
    fn sweep(&self) -> Result<(), StoreError> {
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            // `scratch` belongs to the key, not to a lease: it holds the checkpoint from which the
            // stage goes on.
            if entry.file_name() != "scratch" {
                self.store.files.clear(&entry.path())?;
            }
        }
        Ok(())
    }

    /// Turns what the stage wrote into a result: blobs, flushed, then the record. `replace`
    /// overrules an earlier result.
    pub fn commit(
        self,
        outputs: &[(&str, ArtifactKind)],
        facts: Facts,
        replace: bool,
    ) -> Result<Record, StoreError> {
        let mut kept = BTreeMap::new();
        for (name, kind) in outputs {
            kept.insert((*name).to_owned(), self.keep(name, *kind)?);
        }
        // The record may only be seen when its blobs have names that last: else a loss of power
        // could leave a record without them.
        for file in kept.values().flat_map(|output| &output.files) {
            self.store
                .files
                .flush_folder(parent(&self.store.blobs.path(&file.blob)))?;
        }
        let Facts {
            stage,
            seconds,
            device,
            remarks,
            peak_memory,
        } = facts;
        let record = Record {
            key: self.key,
            stage,
            outputs: kept,
            seconds,
            device,
            remarks,
            peak_memory,
        };
        let record = self.store.results.put(record, replace)?;
        // Last of all: until the record is in place, the checkpoint is all that there is of the
        // work. If the lease was lost meanwhile, the checkpoint is another's.
        if self.lost_to().is_none() {
            self.store.files.clear(&self.scratch())?;
        }
        self.abandon()?;
        Ok(record)
    }

    /// Gives the folder up without a result; scratch stays if there is anything in it.
    pub fn abandon(self) -> Result<(), StoreError> {
        self.store.files.clear(&self.run)?;
        // Both fail, as they should, while there is something in the folder.
        let _ = fs::remove_dir(self.scratch());
        let _ = fs::remove_dir(&self.folder);
        Ok(())
    }

    fn keep(&self, name: &str, kind: ArtifactKind) -> Result<Output, StoreError> {
        let folder = self.outputs().join(name);
        let refused = |problem: String| StoreError::Output {
            output: name.to_owned(),
            problem,
        };
        // First, since taking the blobs moves the files away.
        let digest = semantic_digest(kind, &folder).map_err(|error| refused(error.to_string()))?;
        let mut files = Vec::new();
        // File systems list names in any order; sorted, equal outputs have equal records.
        for entry in WalkDir::new(&folder).sort_by_file_name() {
            let entry = entry.map_err(|error| refused(error.to_string()))?;
            if !entry.file_type().is_dir() {
                let path = relative(entry.path(), &folder)
                    .ok_or_else(|| refused("a file's name is not text".into()))?;
                let (blob, bytes) = self.store.blobs.take(entry.path())?;
                let last_signature = LastSignature(Signature::at(&self.store.blobs.path(&blob)));
                files.push(StoredFile {
                    path,
                    blob,
                    bytes,
                    last_signature,
                });
            }
        }
        Ok(Output {
            kind,
            digest,
            files,
        })
    }
}

/// A path inside a folder, with `/` on every system.
fn relative(path: &Path, folder: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = path
        .strip_prefix(folder)
        .ok()?
        .iter()
        .map(|part| part.to_str())
        .collect();
    parts.map(|parts| parts.join("/"))
}

#[cfg(test)]
mod tests;
