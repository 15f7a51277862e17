//! Looks through a whole store for everything that is not as the program left it, and puts damage
//! out of reach.
//!
//! Other processes may use the store meanwhile: what they have replaced since it was looked at is
//! left alone, and so is all that a running stage may still need. Results that are sound are never
//! touched.

mod blobs;
pub mod fault;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use artifacts_schema::Digest;
use serde::de::DeserializeOwned;
use walkdir::WalkDir;

use super::Store;
use super::blobs::digest_file;
use super::error::StoreError;
use super::files::identity::same_entry;
use super::files::{FILES, FOLDERS};
use super::listing::{Entry, label, references};
use super::record::{Record, is_inside};
use super::runs::RunRecord;
use super::view::View;
use crate::store::manifest::Manifest;
use fault::{Finding, Remedy, StoreFault};

/// What a look through a store came to.
#[derive(Debug, Default)]
pub struct Report {
    /// What is not as it should be, damage first.
    pub findings: Vec<Finding>,
    /// How many blobs are sound, and their bytes.
    pub blobs: (usize, u64),
    /// How many results are sound.
    pub results: usize,
}

/// One look through a store.
struct Fsck<'s> {
    store: &'s Store,
    /// Whether to put damage out of reach.
    mend: bool,
    report: Report,
    /// Sound blobs.
    sound: BTreeSet<Digest>,
}

/// Reads everything through and names what is wrong. With `mend`, damage is moved to
/// `quarantine/`, so that the next run computes what is lost. Files under `out` that show
/// something else than sound blobs are named too; runs show them again.
pub fn look_through(store: &Store, out: &Path, mend: bool) -> Result<Report, StoreError> {
    let mut fsck = Fsck {
        store,
        mend,
        report: Report::default(),
        sound: BTreeSet::new(),
    };
    // Records come first: they say which blobs there should be, how long each is and whose it
    // is.
    let records = fsck.records()?;
    fsck.blobs(&references(records.values().map(|(_, record)| record)))?;
    // Only now, since whether a result is whole depends on all of its blobs, some of which may
    // just have been put back.
    let records = fsck.whole(records)?;
    fsck.manifests(&records)?;
    fsck.runs()?;
    fsck.shown(out, &records)?;
    fsck.leftovers()?;
    fsck.report.results = records.len();
    fsck.report
        .findings
        // The sort is stable: damage stays in the order in which it was found.
        .sort_by_key(|finding| !finding.fault.is_damage());
    Ok(fsck.report)
}

impl Fsck<'_> {
    fn note(&mut self, path: &Path, fault: StoreFault, of: Option<String>, remedy: Remedy) {
        let path = self.relative(path);
        self.report.findings.push(Finding {
            path,
            fault,
            of,
            remedy,
        });
    }

    /// A path inside the store as people read it.
    fn relative(&self, path: &Path) -> String {
        path.strip_prefix(&self.store.files.root)
            .unwrap_or(path)
            .display()
            .to_string()
    }

    /// Names damage and moves it away, unless another process has replaced it meanwhile.
    fn remove(
        &mut self,
        entry: &Entry,
        fault: StoreFault,
        of: Option<String>,
    ) -> Result<(), StoreError> {
        let remedy = match self.mend {
            // Another process may have healed it since it was read. What lies there now is
            // somebody's good result.
            _ if !same_entry(&entry.path, &entry.data) => return Ok(()),
            true => Remedy::Quarantined,
            false => Remedy::None,
        };
        if self.mend {
            self.store.files.set_aside(&entry.path)?;
        }
        self.note(&entry.path, fault, of, remedy);
        Ok(())
    }

    /// The files in the folders `00` to `ff` of a folder; everything else there is damage.
    fn files(&mut self, folder: &str) -> Result<Vec<Entry>, StoreError> {
        let (files, strays) = self.store.files.fanned_entries(folder)?;
        for stray in &strays {
            self.remove(
                stray,
                StoreFault::WrongType {
                    found: stray.wrong_type().unwrap_or("file"),
                },
                None,
            )?;
        }
        let (files, others): (Vec<_>, Vec<_>) = files
            .into_iter()
            .partition(|entry| entry.wrong_type().is_none());
        for other in &others {
            self.remove(
                other,
                StoreFault::WrongType {
                    found: other.wrong_type().unwrap_or("file"),
                },
                None,
            )?;
        }
        Ok(files)
    }

    /// A file's content, or what is wrong with it.
    fn parse<T: DeserializeOwned>(&mut self, entry: &Entry) -> Result<Option<T>, StoreError> {
        let fault = match fs::read(&entry.path) {
            Ok(bytes) => match serde_json::from_slice(&bytes) {
                Ok(content) => return Ok(Some(content)),
                Err(error) => StoreFault::Garbled {
                    problem: error.to_string(),
                },
            },
            Err(error) => StoreFault::Unreadable {
                problem: error.to_string(),
            },
        };
        self.remove(entry, fault, None)?;
        Ok(None)
    }

    /// All records that can be understood and lie where they should.
    fn records(&mut self) -> Result<BTreeMap<Digest, (Entry, Record)>, StoreError> {
        let mut records = BTreeMap::new();
        for entry in self.files("results")? {
            let Some(record) = self.parse::<Record>(&entry)? else {
                continue;
            };
            let of = Some(record.stage.clone());
            if entry.path != self.store.results.path(&record.key) {
                self.remove(&entry, StoreFault::OtherKey { key: record.key }, of)?;
            } else if let Some((_, file)) = record.files().find(|(_, file)| !is_inside(&file.path))
            {
                let problem = format!("the path {:?} leads out of its folder", file.path);
                self.remove(&entry, StoreFault::Garbled { problem }, of)?;
            } else {
                records.insert(record.key, (entry, record));
            }
        }
        Ok(records)
    }

    /// The results whose blobs are all sound; those of the others that are there still are damage.
    fn whole(
        &mut self,
        records: BTreeMap<Digest, (Entry, Record)>,
    ) -> Result<BTreeMap<Digest, Record>, StoreError> {
        let mut whole = BTreeMap::new();
        for (key, (entry, record)) in records {
            let lost = record
                .files()
                .find(|(_, file)| !self.sound.contains(&file.blob));
            match lost.map(|(output, file)| label(&record, output, file)) {
                Some(file) => {
                    self.remove(&entry, StoreFault::WithoutBlob { file }, Some(record.stage))?
                }
                None => drop(whole.insert(key, record)),
            }
        }
        Ok(whole)
    }

    fn manifests(&mut self, records: &BTreeMap<Digest, Record>) -> Result<(), StoreError> {
        let mut missing: BTreeSet<&Digest> = records.keys().collect();
        for entry in self.files("manifests")? {
            let Some(manifest) = self.parse::<Manifest>(&entry)? else {
                continue;
            };
            // A manifest says what its key must be, so that one in a wrong place gives itself away.
            let key = manifest.key();
            if entry.path == self.store.manifests.path(&key) {
                missing.remove(&key);
            } else {
                self.remove(&entry, StoreFault::OtherKey { key }, None)?;
            }
        }
        for key in missing {
            let of = Some(records[key].stage.clone());
            self.note(
                &self.store.results.path(key),
                StoreFault::WithoutManifest,
                of,
                Remedy::None,
            );
        }
        Ok(())
    }

    fn runs(&mut self) -> Result<(), StoreError> {
        for entry in self.store.files.entries("runs")? {
            match entry.wrong_type() {
                Some(found) => self.remove(&entry, StoreFault::WrongType { found }, None)?,
                None => drop(self.parse::<RunRecord>(&entry)?),
            }
        }
        Ok(())
    }

    /// What people see of the last run of each pipeline, where the store still has it.
    fn shown(&mut self, out: &Path, records: &BTreeMap<Digest, Record>) -> Result<(), StoreError> {
        let mut pipelines = BTreeSet::new();
        for run in
            RunRecord::past(self.store, None)?.filter(|run| pipelines.insert(run.pipeline.clone()))
        {
            // The output folder shows the last run alone: whatever earlier runs had there has been
            // replaced.
            let view = View::new(out, &run.pipeline);
            for (stage, record) in run
                .stages
                .iter()
                .filter_map(|(name, stage)| Some((name, records.get(&stage.key?)?)))
            {
                record
                    .outputs
                    .keys()
                    .for_each(|output| self.shown_output(&view.output(stage, output)));
            }
        }
        Ok(())
    }

    /// A file that shows another sound blob is right as well: that of a run which was killed before
    /// it could tell.
    fn shown_output(&mut self, folder: &Path) {
        // A folder that is not there gives an error, which is left out: the next run shows it
        // again.
        for entry in WalkDir::new(folder)
            .sort_by_file_name()
            .into_iter()
            .flatten()
        {
            let is_sound =
                || digest_file(entry.path()).is_ok_and(|(digest, _)| self.sound.contains(&digest));
            // The program makes no symbolic links there, so one is not ours even if it leads to a
            // sound file.
            if !entry.file_type().is_dir() && (entry.path_is_symlink() || !is_sound()) {
                self.note(entry.path(), StoreFault::Shown, None, Remedy::None);
            }
        }
    }

    /// What interrupted runs leave, and what is not ours: named, but never touched.
    fn leftovers(&mut self) -> Result<(), StoreError> {
        for (folder, fault) in [
            ("work", StoreFault::Interrupted),
            ("leases", StoreFault::Lease),
            ("tmp", StoreFault::Temporary),
        ] {
            for entry in self.store.files.entries(folder)? {
                self.note(&entry.path, fault.clone(), None, Remedy::None);
            }
        }
        for entry in self.store.files.entries("")? {
            let name = entry
                .path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if !FOLDERS.contains(&&*name) && !FILES.contains(&&*name) {
                self.note(&entry.path, StoreFault::Stray, None, Remedy::None);
            }
        }
        Ok(())
    }
}
