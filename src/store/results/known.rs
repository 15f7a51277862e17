//! Results that were found sound, as the index remembers them: while neither a record nor its blobs
//! have changed, nobody reads them through again.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

use artifacts_schema::Digest;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::path;
use crate::store::blobs::Blobs;
use crate::store::cache::Cache;
use crate::store::cache::index::{Kind, Location};
use crate::store::cache::signature::Signature;
use crate::store::files::Files;
use crate::store::record::{LastSignature, Record, StoredFile};

/// An index that remembers more than this many times the results that are wanted is not looked
/// through ahead.
const AHEAD: usize = 4;

/// A sound result, as the index remembers it.
#[derive(Serialize, Deserialize)]
struct Seen {
    /// Of the record's file.
    result: Signature,
    /// Of the blobs, in the order of the files.
    blobs: Vec<Signature>,
    record: Record,
}

/// The results of a store that were found sound.
pub struct Known {
    files: Arc<Files>,
    blobs: Arc<Blobs>,
    cache: Arc<Cache>,
    /// Those that were looked up ahead, each until it is asked for.
    ahead: Mutex<BTreeMap<Digest, Record>>,
}

impl Known {
    pub(super) fn new(files: Arc<Files>, blobs: Arc<Blobs>, cache: Arc<Cache>) -> Self {
        Self {
            files,
            blobs,
            cache,
            ahead: Mutex::default(),
        }
    }

    /// The time, for what is to be remembered.
    pub(super) fn now(&self) -> SystemTime {
        self.cache.clock.now()
    }

    /// The result of a key, if it was found sound and has not changed since.
    pub(super) fn get(&self, key: &Digest) -> Option<Record> {
        // Each looked-up result is handed out once: later questions in a long run must see what has
        // changed since.
        let ahead = self
            .ahead
            .lock()
            .ok()
            .and_then(|mut ahead| ahead.remove(key));
        ahead.or_else(|| self.unchanged(key))
    }

    /// Takes over what was looked up ahead in another store object on the same folder.
    pub fn take(&self, other: &Self) {
        // Moved, not shared: what was looked up ahead is used once, by whoever goes on with it.
        if let (Ok(mut ahead), Ok(mut others)) = (self.ahead.lock(), other.ahead.lock()) {
            ahead.append(&mut others);
        }
    }

    /// Whether the index remembers far more results than are `wanted`.
    pub fn are_many(&self, wanted: usize) -> bool {
        self.cache.index.locations(Kind::Result).len() > AHEAD * wanted
    }

    /// Looks up at once what the index remembers, until there is `enough`: all threads together are
    /// faster than one key after the other.
    pub fn look_ahead(&self, enough: &AtomicBool) {
        let find = |location: &Location| {
            let seen = self
                .cache
                .index
                .read(location)
                // Once the pipeline is read and wants few of these results, looking at all of them
                // takes longer than looking each up.
                .filter(|_| !enough.load(Ordering::Relaxed));
            seen.and_then(|seen| self.confirm(seen))
                .map(|record| (record.key, record))
        };
        let found: Vec<_> = self
            .cache
            .index
            .locations(Kind::Result)
            .par_iter()
            .filter_map(find)
            .collect();
        if let Ok(mut ahead) = self.ahead.lock() {
            *ahead = found.into_iter().collect();
        }
    }

    /// A result that was found sound at an earlier time, if neither its record nor any of its blobs
    /// has changed since.
    fn unchanged(&self, key: &Digest) -> Option<Record> {
        self.confirm(self.cache.index.get(Kind::Result, key)?)
            .filter(|record| record.key == *key)
    }

    fn confirm(
        &self,
        Seen {
            result,
            blobs,
            mut record,
        }: Seen,
    ) -> Option<Record> {
        let mut stamps = blobs.iter();
        for file in record
            .outputs
            .values_mut()
            .flat_map(|output| &mut output.files)
        {
            // Kept with the file: whoever shows the result next compares with it, and spares a
            // second look.
            file.last_signature = LastSignature(Signature::at(&self.blobs.path(&file.blob)));
            if file.last_signature.0.as_ref() != Some(stamps.next()?) {
                return None;
            }
        }
        // The record too: a run that forces the stage replaces it, and the old blobs may still be
        // there.
        (Signature::at(&path(&self.files, &record.key)) == Some(result)).then_some(record)
    }

    /// Remembers results that this process has just written, so that the next one need not read
    /// them through: those whose blobs are still as they were written, and were left alone for long
    /// enough that it would show if they were not.
    pub fn remember_own<'r>(&self, records: impl Iterator<Item = &'r Record>) {
        // Results of a moment ago are not settled and are left out. The next run reads them
        // through, and remembers them then.
        let now = self.now();
        for record in records {
            // Showing a result gives its blobs second names, which changes their inodes and not
            // their content.
            let still = |file: &StoredFile| {
                Signature::at(&self.blobs.path(&file.blob)).filter(|now| {
                    file.last_signature
                        .0
                        .is_some_and(|before| now.has_content_of(&before))
                })
            };
            let blobs = record.files().map(|(_, file)| still(file)).collect();
            let result = Signature::at(&path(&self.files, &record.key));
            self.remember(now, record, result, blobs);
        }
    }

    /// Remembers a sound result whose file and blobs had these signatures, if all have one and are
    /// settled.
    pub(super) fn remember(
        &self,
        now: SystemTime,
        record: &Record,
        result: Option<Signature>,
        blobs: Option<Vec<Signature>>,
    ) {
        let (Some(result), Some(blobs)) = (result, blobs) else {
            return;
        };
        let settled = |signature: &Signature| signature.is_settled(now);
        if settled(&result) && blobs.iter().all(settled) {
            let seen = Seen {
                result,
                blobs,
                record: record.clone(),
            };
            self.cache.index.put(Kind::Result, &record.key, &seen);
        }
    }
}
