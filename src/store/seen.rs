//! Results that were found sound, as the index remembers them: while neither a record nor its blobs
//! have changed, nobody reads them through again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use artifacts_schema::Digest;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Store;
use super::index::{Kind, Place};
use super::record::{Glance, Record, StoredFile};
use super::signature::Signature;

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

impl Store {
    /// Whether the index remembers far more results than are `wanted`.
    pub fn remembers_many(&self, wanted: usize) -> bool {
        self.index.places(Kind::Result).len() > AHEAD * wanted
    }

    /// Looks up at once what the index remembers, until there is `enough`: all threads together are
    /// faster than one key after the other.
    pub fn look_ahead(&self, enough: &AtomicBool) {
        let find = |place: &Place| {
            let seen = self
                .index
                .read(place)
                // Once the pipeline is read and wants few of these results, looking at all of them
                // takes longer than looking each up.
                .filter(|_| !enough.load(Ordering::Relaxed));
            seen.and_then(|seen| self.confirm(seen))
                .map(|record| (record.key, record))
        };
        let found: Vec<_> = self
            .index
            .places(Kind::Result)
            .par_iter()
            .filter_map(find)
            .collect();
        if let Ok(mut known) = self.known.lock() {
            *known = found.into_iter().collect();
        }
    }

    /// A result that was found sound at an earlier time, if neither its record nor any of its blobs
    /// has changed since.
    pub(super) fn unchanged(&self, key: &Digest) -> Option<Record> {
        self.confirm(self.index.get(Kind::Result, key)?)
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
            file.glance = Glance(Signature::at(&self.blob_path(&file.blob)));
            if file.glance.0.as_ref() != Some(stamps.next()?) {
                return None;
            }
        }
        // The record too: a run that forces the stage replaces it, and the old blobs may still be
        // there.
        (Signature::at(&self.result_path(&record.key)) == Some(result)).then_some(record)
    }

    /// Remembers results that this process has just written, so that the next one need not read
    /// them through: those whose blobs are still as they were written, and were left alone for long
    /// enough that it would show if they were not.
    pub fn remember_own<'r>(&self, records: impl Iterator<Item = &'r Record>) {
        // Results of a moment ago are not settled and are left out. The next run reads them
        // through, and remembers them then.
        let now = self.clock.now();
        for record in records {
            // Showing a result gives its blobs second names, which changes their inodes and not
            // their content.
            let still = |file: &StoredFile| {
                Signature::at(&self.blob_path(&file.blob)).filter(|now| {
                    file.glance
                        .0
                        .is_some_and(|before| now.has_content_of(&before))
                })
            };
            let blobs = record.files().map(|(_, file)| still(file)).collect();
            let result = Signature::at(&self.result_path(&record.key));
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
            self.index.put(Kind::Result, &record.key, &seen);
        }
    }
}
