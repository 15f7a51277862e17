//! No-op runs: that all results of a pipeline were there, and every file that was looked at to find
//! it out. While none of them changes, they still are. With thousands of stages that is quicker
//! than to read the pipeline, compute all keys and look them up. It is a cache and nothing else.
//! Knows nothing of pipelines: the question that it answers is a digest, and a stage a name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use artifacts_schema::Digest;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::index::{Index, Kind};
use super::signature::Signature;
use crate::store::files::Files;
use crate::store::record::Record;

/// A pipeline all of whose results are there.
#[derive(Serialize, Deserialize)]
pub struct UpToDate {
    /// The pipeline's name.
    pub pipeline: String,
    /// Its stages and their keys.
    pub stages: Vec<(String, Digest)>,
    /// Those results, by their stages, of which a run prints something.
    pub told: Vec<(String, Record)>,
}

/// The same, with what it rests on.
#[derive(Serialize, Deserialize)]
struct Entry {
    up_to_date: UpToDate,
    looked: Vec<(String, Signature)>,
}

/// The no-op runs that are kept.
pub struct NoOpCache {
    files: Arc<Files>,
    /// In a file of its own, which is read first and by itself.
    index: Index,
}

impl NoOpCache {
    pub fn new(files: Arc<Files>) -> Self {
        let index = Index::new(files.root.join("standing"));
        Self { files, index }
    }

    /// The answer that the same question had before, if nothing has changed since of what it rests
    /// on.
    pub fn get(&self, question: &Digest) -> Option<UpToDate> {
        let Entry { up_to_date, looked } = self.index.get(Kind::NoOp, question)?;
        let stands = |(path, before): &(String, Signature)| {
            Signature::at(Path::new(path)).as_ref() == Some(before)
        };
        // One look at each file is all that a run with nothing to do needs. With thousands of them
        // that is what takes its time.
        looked.par_iter().all(stands).then_some(up_to_date)
    }

    /// Keeps an answer which was found after `since` and rests on these files and folders. If one
    /// of them is gone or changed so late that what was found may not be what is there now, nothing
    /// is kept.
    pub fn put(
        &self,
        question: &Digest,
        up_to_date: UpToDate,
        files: BTreeSet<PathBuf>,
        since: SystemTime,
    ) {
        let look = |path: PathBuf| {
            // Settled before the looking began: what changed during the run may have done so after
            // it was looked at.
            let signature = Signature::at(&path).filter(|signature| signature.is_settled(since))?;
            // A path that is not text cannot be written down, and then nothing is kept.
            Some((path.into_os_string().into_string().ok()?, signature))
        };
        if let Some(looked) = files.into_par_iter().map(look).collect() {
            self.index
                .put(Kind::NoOp, question, &Entry { up_to_date, looked });
            self.index
                .keep(|path, bytes| drop(self.files.put(path, bytes)));
        }
    }
}
