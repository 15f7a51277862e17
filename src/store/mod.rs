//! The store: immutable blobs by digest, results by key. `docs/store.md` has the annotated tree.
//!
//! Knows nothing of pipelines but which arms a run compares; a stage is a name, a key and a folder
//! of outputs to it.

pub mod blobs;
pub mod cache;
pub mod error;
pub mod evidence;
pub mod files;
pub mod fsck;
pub mod gc;
pub mod leases;
pub mod link;
pub mod listing;
pub mod manifest;
pub mod manifests;
pub mod pins;
pub mod record;
pub mod results;
pub mod runs;
pub mod state;
pub mod usage;
pub mod view;
pub mod work;

#[cfg(test)]
mod crash;
#[cfg(test)]
mod testing;

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::Arc;

use blobs::Blobs;
use cache::Cache;
use cache::clock::Clock;
use cache::no_op::NoOpCache;
use error::{At, StoreError};
use files::Files;
use files::disk::Disk;
use leases::{LeaseTimeouts, Leases};
use manifests::Manifests;
use results::Results;

/// A store in a folder.
pub struct Store {
    files: Arc<Files>,
    /// Blobs by digest.
    pub blobs: Arc<Blobs>,
    /// What earlier processes have found.
    pub cache: Arc<Cache>,
    /// Results by key.
    pub results: Results,
    /// What went into each key.
    pub manifests: Manifests,
    /// Pipelines all of whose results were there.
    pub no_ops: NoOpCache,
    /// Keys that are being computed.
    leases: Leases,
    /// Locked for as long as this lives: shared by all who write, or alone. The system unlocks it
    /// when the process dies.
    lock: Option<File>,
}

/// What is outside of a store, which tests make otherwise than it is.
#[derive(Default)]
struct World {
    disk: Disk,
    clock: Clock,
    lease_timeouts: LeaseTimeouts,
}

impl Store {
    /// A store for reading; one that does not exist is empty.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        let files = Files::open(Disk::default(), root)?;
        Ok(Self::of(files, Clock::default(), LeaseTimeouts::default()))
    }

    /// A store for writing; its folders are made where they are missing. One that is there and can
    /// only be read will do for a run that has nothing to compute.
    pub fn create(root: &Path) -> Result<Self, StoreError> {
        Self::create_in(World::default(), root)
    }

    fn create_in(world: World, root: &Path) -> Result<Self, StoreError> {
        let mut files = Files::open(world.disk, root)?;
        let lock = match files.prepare().and_then(|()| share(&files)) {
            // `version` is written last: where it is, a whole store was made, which can be read.
            Err(error) if error.is_refusal() && root.join("version").exists() => {
                files.read_only = true;
                None
            }
            lock => Some(lock?),
        };
        Ok(Self {
            lock,
            ..Self::of(files, world.clock, world.lease_timeouts)
        })
    }

    fn of(files: Files, clock: Clock, lease_timeouts: LeaseTimeouts) -> Self {
        let files = Arc::new(files);
        let blobs = Arc::new(Blobs::new(files.clone()));
        let cache = Arc::new(Cache::new(files.clone(), clock));
        Self {
            results: Results::new(files.clone(), blobs.clone(), cache.clone()),
            manifests: Manifests::new(files.clone(), cache.clone()),
            no_ops: NoOpCache::new(files.clone()),
            leases: Leases::new(files.clone(), lease_timeouts),
            lock: None,
            files,
            blobs,
            cache,
        }
    }

    /// Takes over what another store object on the same folder has found.
    pub fn take_findings(&self, other: &Self) {
        self.cache.index.take(&other.cache.index);
        self.results.known.take(&other.results.known);
    }

    /// Keeps others from removing what is read here, where there is a store and it can be locked.
    pub fn share_if_there(&mut self) {
        // Reading is enough for a shared lock, so that a store which cannot be written is protected
        // too.
        self.lock = File::open(self.files.root.join("lock")).ok();
        let _ = self.lock.iter().try_for_each(File::lock_shared);
    }

    /// Keeps everyone else from using the store; an error if anyone does.
    pub fn alone(&mut self) -> Result<(), StoreError> {
        let root = &self.files.root;
        let file = lock_file(&self.files)?;
        // It does not wait: runs last for hours, and whoever cleans up can come back.
        match file.try_lock() {
            Ok(()) => self.lock = Some(file),
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::InUse { root: root.clone() });
            }
            Err(TryLockError::Error(error)) => {
                return Err(error).at("lock", &root.join("lock"));
            }
        }
        // Another host's locks may not show here, but its leases do.
        if self.leases.any_live()? {
            Err(StoreError::InUse { root: root.clone() })
        } else {
            Ok(())
        }
    }
}

/// Keeps others from removing what this process may need. A file system without locks takes it as
/// it is.
fn share(files: &Files) -> Result<File, StoreError> {
    let file = lock_file(files)?;
    // This waits for a `gc` that removes things just now. An error means that the file system has
    // no locks; then the age of blobs is what protects a run (docs/store.md, Garbage).
    let _ = file.lock_shared();
    Ok(file)
}

fn lock_file(files: &Files) -> Result<File, StoreError> {
    let path = files.root.join("lock");
    File::options()
        .create(true)
        .append(true)
        .open(&path)
        .at("open", &path)
}
