//! Leases: which process computes which key. Knows nothing of what is computed.
//!
//! A lease is a file `leases/<key>.<generation>`, put there only if absent; the highest generation
//! of a key holds it. Its holder touches it every few seconds. Whoever finds the holder dead puts
//! the next generation beside it, which only one can, and removes the older file, by which a holder
//! that was only asleep learns that its work is another's now. No clock is compared with another: a
//! waiter measures on its own how long a file has gone untouched.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use artifacts_schema::Digest;

use super::error::{At, StoreError};
use super::holder::Holder;
use super::link::identity;
use super::{Store, json, read_json};

/// How long leases last without a sign of life.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// How often a holder touches its lease.
    pub beat: Duration,
    /// How long a lease may go untouched.
    pub stale: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            beat: Duration::from_secs(5),
            stale: Duration::from_secs(60),
        }
    }
}

/// Who has a key.
pub enum Claim<'s> {
    /// We do.
    Ours(Lease<'s>),
    /// Someone else does.
    Theirs(Holder),
}

/// The right to compute a key, until it is dropped or taken over.
pub struct Lease<'s> {
    store: &'s Store,
    key: Digest,
    path: PathBuf,
    file: Arc<File>,
    lost: Arc<AtomicBool>,
    heart: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Store {
    /// Takes the lease of a key, if nobody alive has it.
    pub fn lease(&self, key: &Digest) -> Result<Claim<'_>, StoreError> {
        let before = self.latest_lease(key)?;
        if let Some((_, path)) = &before
            && !self.is_stale(path)?
        {
            return self.theirs(path);
        }
        let generation = before.as_ref().map_or(0, |(generation, _)| generation + 1);
        let path = self.lease_path(key, generation);
        // Of several who find the same lease dead, only one can put this file: the others see it as
        // taken.
        if !self.put_new(&path, &json(&path, Holder::this_process())?)? {
            return self.theirs(&path);
        }
        let lease = Lease::new(self, *key, path)?;
        // Between our look and our mark the older lease may have been taken over, and even given
        // back, by another.
        let overtaken = self
            .latest_lease(key)?
            .is_none_or(|(latest, _)| latest != generation)
            || before.as_ref().is_some_and(|(_, path)| !path.exists());
        if overtaken {
            // The lease is dropped here and gives its file back. The key is asked for again a
            // moment later.
            return Ok(Claim::Theirs(Holder::this_process().clone()));
        }
        // Only now that the key is ours for certain: the missing file tells a holder who was asleep
        // that it has lost.
        if let Some((_, path)) = before {
            self.disk.remove_file(&path).at("remove", &path)?;
        }
        Ok(Claim::Ours(lease))
    }

    fn theirs(&self, path: &Path) -> Result<Claim<'_>, StoreError> {
        // The file may be gone or garbled by now. Someone has the key all the same, and their
        // name is only for the message.
        Ok(Claim::Theirs(read_json(path)?.unwrap_or_default()))
    }

    /// Who has a key now, as far as that can be said.
    fn holder(&self, key: &Digest) -> Holder {
        let latest = self.latest_lease(key).ok().flatten();
        latest
            .and_then(|(_, path)| read_json(&path).ok().flatten())
            .unwrap_or_default()
    }

    fn lease_path(&self, key: &Digest, generation: u64) -> PathBuf {
        self.root.join("leases").join(format!("{key}.{generation}"))
    }

    /// The highest generation of a key's leases.
    fn latest_lease(&self, key: &Digest) -> Result<Option<(u64, PathBuf)>, StoreError> {
        let folder = self.root.join("leases");
        let name = key.to_string();
        let generation = |entry: fs::DirEntry| {
            let generation = entry
                .file_name()
                .to_str()?
                .strip_prefix(&name)?
                .strip_prefix('.')?
                .parse()
                .ok()?;
            Some((generation, entry.path()))
        };
        Ok(fs::read_dir(&folder)
            .at("read", &folder)?
            .flatten()
            .filter_map(generation)
            .max())
    }

    /// Whether a lease's holder is dead: the system says so, or nobody has touched it for too long.
    pub(super) fn is_stale(&self, path: &Path) -> Result<bool, StoreError> {
        let holder: Holder = read_json(path)?.unwrap_or_default();
        let touched = match fs::metadata(path).and_then(|data| data.modified()) {
            Ok(touched) => touched,
            // Given back just now, or taken over: that is for the next look to find out.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(error).at("read", path),
        };
        // The dead on this host are known at once. Of others only their silence is, as we measure
        // it ourselves.
        Ok(holder.is_dead() || self.untouched(path, touched) > self.patience.stale)
    }

    /// For how long we have seen this time on a file, by our own steady clock.
    fn untouched(&self, path: &Path, touched: SystemTime) -> Duration {
        let Ok(mut seen) = self.seen.lock() else {
            return Duration::ZERO;
        };
        let (last, since) = seen
            .entry(path.to_owned())
            .or_insert_with(|| (touched, Instant::now()));
        // Any other time counts, an earlier one too: only that it changes matters, so no two clocks
        // are compared.
        if *last != touched {
            (*last, *since) = (touched, Instant::now());
        }
        since.elapsed()
    }
}

impl<'s> Lease<'s> {
    fn new(store: &'s Store, key: Digest, path: PathBuf) -> Result<Self, StoreError> {
        // The open file is kept, and not just its name: once all leases of a key are gone, the same
        // name can be another's.
        let file = Arc::new(File::options().write(true).open(&path).at("open", &path)?);
        let lost = Arc::new(AtomicBool::new(false));
        // A channel in place of a sleep, so that giving the key back need not wait for the next
        // beat.
        let (stop, stopped) = mpsc::channel();
        let beat = store.patience.beat;
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
            store,
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
        (self.is_lost() || is_gone(&self.file, &self.path)).then(|| self.store.holder(&self.key))
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
            let _ = self.store.disk.remove_file(&self.path);
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

#[cfg(test)]
mod tests;
