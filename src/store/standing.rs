//! That all results of a pipeline were there, and every file that was looked at to find it out:
//! while none of them changes, they still are. With thousands of stages that is quicker than to
//! read the pipeline, compute all keys and look them up. It is a cache and nothing else. Knows
//! nothing of pipelines: the question that it answers is a digest, and a stage a name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use artifacts_schema::Digest;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::index::Kind;
use super::record::Record;
use super::signature::Signature;
use super::{Store, parent};

/// All results of a pipeline.
#[derive(Serialize, Deserialize)]
pub struct Standing {
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
    standing: Standing,
    looked: Vec<(String, Signature)>,
}

impl Store {
    /// The answer that the same question had before, if nothing has changed since of what it rests
    /// on.
    pub fn standing(&self, question: &Digest) -> Option<Standing> {
        let Entry { standing, looked } = self.standings.get(Kind::Standing, question)?;
        let stands = |(path, before): &(String, Signature)| {
            Signature::at(Path::new(path)).as_ref() == Some(before)
        };
        // One look at each file is all that a run with nothing to do needs. With thousands of them
        // that is what takes its time.
        looked.par_iter().all(stands).then_some(standing)
    }

    /// Keeps an answer which was found after `since` and rests on these files and folders. If one
    /// of them is gone or changed so late that what was found may not be what is there now, nothing
    /// is kept.
    pub fn put_standing(
        &self,
        question: &Digest,
        standing: Standing,
        files: BTreeSet<PathBuf>,
        since: SystemTime,
    ) {
        let look = |path: PathBuf| {
            // Settled before the looking began: what changed during the run may have done so after
            // it was looked at.
            let signature = Signature::at(&path).filter(|signature| signature.is_settled(since))?;
            Some((path.into_os_string().into_string().ok()?, signature))
        };
        if let Some(looked) = files.into_par_iter().map(look).collect() {
            self.standings
                .put(Kind::Standing, question, &Entry { standing, looked });
            self.standings
                .keep(|path, bytes| drop(self.put(path, bytes)));
        }
    }

    /// The files and folders that say of a result that it is there and sound.
    pub fn evidence(&self, record: &Record) -> Vec<PathBuf> {
        // The folder stands for the manifests in it: it changes when one of its names does.
        let files = [
            self.result_path(&record.key),
            parent(&self.manifest_path(&record.key)).to_owned(),
        ];
        files
            .into_iter()
            .chain(record.files().map(|(_, file)| self.blob_path(&file.blob)))
            .collect()
    }

    /// Those that say that it is shown, each output in its folder.
    pub fn evidence_shown(
        &self,
        record: &Record,
        folder: impl Fn(&str) -> PathBuf,
    ) -> Vec<PathBuf> {
        // An artifact without files is an empty folder.
        let mut files: Vec<PathBuf> = record.outputs.keys().map(|output| folder(output)).collect();
        for (output, file) in record.files() {
            let folder = folder(output);
            let shown = folder.join(&file.path);
            // Between the file and the artifact's folder may lie others.
            files.extend(
                shown
                    .ancestors()
                    .skip(1)
                    .take_while(|path| path.starts_with(&folder))
                    .map(Path::to_owned),
            );
            // A hard link has its blob's signature, and the blob is looked at anyway. A copy has to
            // be looked at by itself.
            if Signature::at(&shown) != Signature::at(&self.blob_path(&file.blob)) {
                files.push(shown);
            }
        }
        files
    }
}
