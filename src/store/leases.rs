//! Leases: which process computes which key. Knows nothing of what is computed.
//!
//! A lease is a file `leases/<key>.<generation>`, put there only if absent; the highest generation
//! of a key holds it. Its holder touches it every few seconds. Whoever finds the holder dead puts
//! the next generation beside it, which only one can, and removes the older file, by which a holder
//! that was only asleep learns that its work is another's now. No clock is compared with another: a
//! waiter measures on its own how long a file has gone untouched.

pub mod holder;
pub mod lease;

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use artifacts_schema::Digest;

use super::error::{At, StoreError};
use super::files::{Files, json, read_json};
use super::listing::Entry;
use holder::Holder;
use lease::Lease;

/// A lease that was left alone for so long keeps nobody out any more.
const FORGOTTEN: Duration = Duration::from_secs(3600);

/// How long leases last without a sign of life.
#[derive(Clone, Copy, Debug)]
pub struct LeaseTimeouts {
    /// How often a holder touches its lease.
    pub beat: Duration,
    /// How long a lease may go untouched.
    pub stale: Duration,
}

impl Default for LeaseTimeouts {
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

/// The leases of a store.
pub struct Leases {
    files: Arc<Files>,
    timeouts: LeaseTimeouts,
    /// When each lease of others was last touched, and since when we have seen that.
    seen: Mutex<BTreeMap<PathBuf, (SystemTime, Instant)>>,
}

impl Leases {
    pub(super) fn new(files: Arc<Files>, timeouts: LeaseTimeouts) -> Self {
        Self {
            files,
            timeouts,
            seen: Mutex::default(),
        }
    }

    /// Takes the lease of a key, if nobody alive has it.
    pub fn take(&self, key: &Digest) -> Result<Claim<'_>, StoreError> {
        let before = self.latest(key)?;
        if let Some((_, path)) = &before
            && !self.is_stale(path)?
        {
            return self.theirs(path);
        }
        let generation = before.as_ref().map_or(0, |(generation, _)| generation + 1);
        let path = self.path(key, generation);
        // Of several who find the same lease dead, only one can put this file: the others see it as
        // taken.
        if !self
            .files
            .put_new(&path, &json(&path, Holder::this_process())?)?
        {
            return self.theirs(&path);
        }
        let lease = Lease::new(self, *key, path)?;
        // Between our look and our mark the older lease may have been taken over, and even given
        // back, by another.
        let overtaken = self
            .latest(key)?
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
            self.files.disk.remove_file(&path).at("remove", &path)?;
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
        let latest = self.latest(key).ok().flatten();
        latest
            .and_then(|(_, path)| read_json(&path).ok().flatten())
            .unwrap_or_default()
    }

    fn path(&self, key: &Digest, generation: u64) -> PathBuf {
        self.files
            .root
            .join("leases")
            .join(format!("{key}.{generation}"))
    }

    /// The highest generation of a key's leases.
    fn latest(&self, key: &Digest) -> Result<Option<(u64, PathBuf)>, StoreError> {
        let folder = self.files.root.join("leases");
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
    fn is_stale(&self, path: &Path) -> Result<bool, StoreError> {
        // A lease that is garbled names nobody, and then only its silence counts.
        let holder: Holder = read_json(path)?.unwrap_or_default();
        let touched = match fs::metadata(path).and_then(|data| data.modified()) {
            Ok(touched) => touched,
            // Given back just now, or taken over: that is for the next look to find out.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(error).at("read", path),
        };
        // The dead on this host are known at once. Of others only their silence is, as we measure
        // it ourselves.
        Ok(holder.is_dead() || self.untouched(path, touched) > self.timeouts.stale)
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
            *last = touched;
            *since = Instant::now();
        }
        since.elapsed()
    }
    /// Whether any process may be computing something, on whatever host.
    pub(super) fn any_live(&self) -> Result<bool, StoreError> {
        let leases = self.files.entries("leases")?;
        // A lease that nobody has touched for an hour is of a process that died on another host.
        // Without this limit it would keep `gc` out for ever.
        let is_live =
            |entry: &Entry| Ok(!entry.is_older(FORGOTTEN) && !self.is_stale(&entry.path)?);
        leases
            .iter()
            .map(is_live)
            .try_fold(
                false,
                |any, live: Result<bool, StoreError>| Ok(any || live?),
            )
    }
}

#[cfg(test)]
mod tests;
