//! A store that several machines share: S3, Google Cloud Storage, Azure or a folder. It has the
//! layout of a local store.
//!
//! Results that the local store lacks are read from it, and those computed here are written to it.
//! When it does not answer, after a few attempts, it is left alone for the rest of the run, and
//! that is said once: it spares time, and nothing depends on it. Knows nothing of pipelines and
//! stages.

mod address;
mod fault;
mod health;
mod retry;
mod transfer;

use artifacts_schema::Digest;
use object_store::ObjectStore;
use object_store::path::Path;
use tokio::runtime::Runtime;

use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::record::Record;
pub use address::AddressError;
pub use fault::RemoteFault;
use health::Health;
use retry::RetryLimits;

/// A shared store.
pub struct Remote {
    name: String,
    objects: Box<dyn ObjectStore>,
    root: Path,
    retry: RetryLimits,
    runtime: Runtime,
    health: Health,
}

/// What was sent or received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub results: usize,
    /// The bytes of their blobs, as far as those were not there already.
    pub bytes: u64,
}

impl Remote {
    /// The remote at an address such as `s3://bucket/folder`. Credentials come from the
    /// environment; nothing is asked of it yet.
    pub fn open(address: &str) -> Result<Self, AddressError> {
        let (objects, root) = address::open(address)?;
        // Threads of its own: transfers wait most of the time, and the pool of the stages should
        // not wait with them.
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build();
        let runtime = runtime.map_err(|error| AddressError::new(address, error.to_string()))?;
        let name = address.trim_end_matches('/').to_owned();
        Ok(Self {
            name,
            objects,
            root,
            retry: RetryLimits::default(),
            runtime,
            health: Health::default(),
        })
    }

    /// A result that is there with all its blobs; fetches none of them.
    pub fn peek(&self, key: &Digest) -> Option<Record> {
        self.unless_lost(key, || self.runtime.block_on(self.find(key)))
    }

    /// Fetches a result into the local store: its record, and how many bytes came. None of it is
    /// visible there before all of it is known to be sound. A key is asked for once.
    pub fn fetch(&self, store: &Store, key: &Digest) -> Result<Option<(Record, u64)>, StoreError> {
        if !self.health.is_new(key) {
            return Ok(None);
        }
        // The local store's errors end the run, those of the remote do not. So they leave by
        // another way.
        let mut local = None;
        let fetched = self.unless_lost(key, || {
            match self.runtime.block_on(self.bring(store, key)) {
                Err(RemoteFault::Local(error)) => {
                    local = Some(error);
                    Ok(None)
                }
                other => other,
            }
        });
        local.map_or(Ok(fetched), Err)
    }

    fn unless_lost<T>(
        &self,
        key: &Digest,
        ask: impl FnOnce() -> Result<Option<T>, RemoteFault>,
    ) -> Option<T> {
        // Each question to a remote that is gone would cost all attempts again.
        if self.health.is_lost() {
            return None;
        }
        ask().unwrap_or_else(|fault| {
            self.health.read_failed(&self.name, key, &fault);
            None
        })
    }

    /// Puts a result of the local store there, unless it is there already.
    pub fn publish(&self, store: &Store, record: &Record) {
        // A failure here fails nothing: the result is in the local store, and `store push` can send
        // it later.
        if self.health.takes_results() {
            let sent = self.runtime.block_on(self.send(
                store,
                record,
                self.health.is_damaged(&record.key),
            ));
            sent.map_or_else(|fault| self.health.write_failed(&self.name, &fault), drop);
        }
    }

    /// What the user should hear, each thing once.
    pub fn notices(&self) -> Vec<String> {
        self.health.notices()
    }

    /// Puts all sound results of the local store there; the first fault ends it.
    pub fn push(&self, store: &Store) -> Result<Traffic, RemoteFault> {
        let mut traffic = Traffic::default();
        for key in store.results.keys()? {
            // Damage must not spread: each result is read through before others get it.
            if let Some(record) = store.results.lookup(&key)?.sound() {
                let (new, bytes) = self.runtime.block_on(self.send(store, &record, false))?;
                traffic.add(new, bytes);
            }
        }
        Ok(traffic)
    }

    /// Fetches all results that the local store lacks. The first fault ends it; a damaged result is
    /// told of and left out.
    pub fn pull(
        &self,
        store: &Store,
        damaged: &mut dyn FnMut(&Digest, &str),
    ) -> Result<Traffic, RemoteFault> {
        let mut traffic = Traffic::default();
        for key in self.runtime.block_on(self.keys())? {
            if store.results.lookup(&key)?.sound().is_some() {
                continue;
            }
            match self.runtime.block_on(self.bring(store, &key)) {
                Ok(fetched) => fetched
                    .iter()
                    .for_each(|(_, bytes)| traffic.add(true, *bytes)),
                // One damaged result says nothing of the others. A remote that does not answer
                // would not answer for those either.
                Err(RemoteFault::Damaged(what)) => damaged(&key, &what),
                Err(fault) => return Err(fault),
            }
        }
        Ok(traffic)
    }
}

impl Traffic {
    fn add(&mut self, new: bool, bytes: u64) {
        self.results += usize::from(new);
        self.bytes += bytes;
    }
}
