//! Blobs, all read through: sound ones, and what is in their place. Knows of results only which
//! blobs they refer to.

use std::fs;
use std::io;

use artifacts_schema::Digest;
use rayon::prelude::*;

use super::Fsck;
use super::fault::{Remedy, StoreFault};
use crate::store::blobs::digest_file;
use crate::store::error::{At, StoreError};
use crate::store::files::identity::same_entry;
use crate::store::listing::{Entry, References};

impl Fsck<'_> {
    /// Reads all blobs through.
    pub(super) fn blobs(&mut self, references: &References) -> Result<(), StoreError> {
        let files = self.files("cas")?;
        // Reading goes on all threads. What follows changes the store and the report, in the order
        // of names.
        let digests: Vec<_> = files
            .par_iter()
            .map(|entry| digest_file(&entry.path))
            .collect();
        for (entry, digest) in files.iter().zip(digests) {
            match digest {
                Ok((digest, bytes)) if entry.path == self.store.blobs.path(&digest) => {
                    self.sound_blob(entry, digest, bytes, references)?;
                }
                Ok((digest, bytes)) => self.wrong_blob(entry, digest, bytes, references)?,
                // Removed since the folder was listed; whether a result misses it is found out
                // later.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => {
                    let of = entry
                        .digest()
                        .and_then(|name| references.get(&name))
                        .map(|(_, of)| of.clone());
                    self.remove(
                        entry,
                        StoreFault::Unreadable {
                            problem: error.to_string(),
                        },
                        of,
                    )?;
                }
            }
        }
        Ok(())
    }

    fn sound_blob(
        &mut self,
        entry: &Entry,
        digest: Digest,
        bytes: u64,
        references: &References,
    ) -> Result<(), StoreError> {
        self.sound.insert(digest);
        self.report.blobs.0 += 1;
        self.report.blobs.1 += bytes;
        let of = references.get(&digest).map(|(_, of)| of.clone());
        if of.is_none() {
            // No damage: a process that runs just now may be about to put the record for it.
            self.note(
                &entry.path,
                StoreFault::Orphan { bytes },
                None,
                Remedy::None,
            );
        }
        if !entry.data.permissions().readonly() {
            let remedy = if self.mend {
                Remedy::Mended
            } else {
                Remedy::None
            };
            if self.mend {
                self.store
                    .files
                    .disk
                    .protect(&entry.path)
                    .at("protect", &entry.path)?;
            }
            self.note(&entry.path, StoreFault::Writable, of, remedy);
        }
        Ok(())
    }

    /// A file in `cas/` whose bytes are not those of its name. If they are those of a blob that is
    /// missed, it goes there.
    fn wrong_blob(
        &mut self,
        entry: &Entry,
        found: Digest,
        bytes: u64,
        references: &References,
    ) -> Result<(), StoreError> {
        let place = self.store.blobs.path(&found);
        // Only where it is missed and the place is free: a good blob must never be replaced by one
        // that was found elsewhere.
        if let Some((_, of)) = references.get(&found)
            && fs::symlink_metadata(&place).is_err()
        {
            let remedy = if self.mend {
                Remedy::Mended
            } else {
                Remedy::None
            };
            // Another process may have replaced it since it was read.
            if !same_entry(&entry.path, &entry.data) {
                return Ok(());
            }
            if self.mend {
                self.store.blobs.keep(&entry.path)?;
                self.sound.insert(found);
            }
            self.note(
                &entry.path,
                StoreFault::Misnamed { blob: found },
                Some(of.clone()),
                remedy,
            );
            return Ok(());
        }
        let known = entry.digest().and_then(|name| references.get(&name));
        let fault = match known {
            Some((expected, _)) if bytes < *expected => StoreFault::Truncated {
                bytes,
                expected: *expected,
            },
            Some((expected, _)) if bytes > *expected => StoreFault::Grown {
                bytes,
                expected: *expected,
            },
            // A name that is no digest says nothing of which bytes were there.
            _ if entry.digest().is_none() => StoreFault::Misnamed { blob: found },
            _ => StoreFault::Changed,
        };
        self.remove(entry, fault, known.map(|(_, of)| of.clone()))
    }
}
