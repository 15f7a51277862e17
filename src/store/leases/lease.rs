//! One lease, as the process that holds it has it: kept alive, and given back. Knows not how it is
//! taken.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::SystemTime;

use artifacts_schema::Digest;

use super::Leases;
use super::holder::Holder;
use crate::store::error::{At, StoreError};
use crate::store::files::identity::identity;

/// The right to compute a key, until it is dropped or taken over.
pub struct Lease<'s> {
    leases: &'s Leases,
    key: Digest,
    pub(super) path: PathBuf,
    pub(super) file: Arc<File>,
    lost: Arc<AtomicBool>,
    heart: Option<(Sender<()>, JoinHandle<()>)>,
}

impl<'s> Lease<'s> {
    pub(super) fn new(leases: &'s Leases, key: Digest, path: PathBuf) -> Result<Self, StoreError> {
        // The open file is kept, and not just its name: once all leases of a key are gone, the same
        // name can be another's.
        let file = Arc::new(File::options().write(true).open(&path).at("open", &path)?);
        let lost = Arc::new(AtomicBool::new(false));
        // A channel in place of a sleep, so that giving the key back need not wait for the next
        // beat.
        let (stop, stopped) = mpsc::channel();
        let beat = leases.timeouts.beat;
        let lease = (path.clone(), file.clone(), lost.clone());
        let heart = std::thread::spawn(move || {
            let (path, file, lost) = lease;
            while stopped.recv_timeout(beat) == Err(RecvTimeoutError::Timeout) {
                // Whoever cannot touch its lease will find it gone.
                let _ = file.set_modified(SystemTime::now());
                // What is lost stays lost: a file of the same name that comes later is another's.
                lost.fetch_or(is_gone(&file, &path), Ordering::Relaxed);
            }
        });
        Ok(Self {
            leases,
            key,
            path,
            file,
            lost,
            heart: Some((stop, heart)),
        })
    }

    /// Whether another process was seen to have taken the key over; as new as the last beat.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// The process that has, after looking.
    pub fn lost_to(&self) -> Option<Holder> {
        (self.is_lost() || is_gone(&self.file, &self.path)).then(|| self.leases.holder(&self.key))
    }
}

impl Drop for Lease<'_> {
    /// Gives the key back, unless it is another's already.
    fn drop(&mut self) {
        if let Some((stop, heart)) = self.heart.take() {
            // The heart ends when its channel closes. It is joined first, so that it cannot touch
            // what is removed next.
            drop(stop);
            let _ = heart.join();
        }
        // A file that another process has put there in the meantime is not ours to remove.
        if !is_gone(&self.file, &self.path) {
            // A lease that stays behind is dead as soon as this process is.
            let _ = self.leases.files.disk.remove_file(&self.path);
        }
    }
}

/// Whether a path does not lead to this open file any more. Where the system does not say, it does.
fn is_gone(file: &File, path: &Path) -> bool {
    match (file.metadata(), fs::metadata(path)) {
        (Ok(ours), Ok(there)) => identity(&ours) != identity(&there),
        (_, Err(error)) => error.kind() == io::ErrorKind::NotFound,
        // To believe that a lease is lost throws work away, so doubt keeps it: no identity, or a
        // file system that does not answer.
        _ => false,
    }
}
