//! Run records: what each run of a pipeline did, newest last. `explain` and `metrics` read them.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};

use super::Store;
use super::error::{At, StoreError};
use super::files::read_json;
use crate::pipeline::experiment::Experiment;

/// What one run did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// The pipeline's name.
    pub pipeline: String,
    /// When it began, in UTC: `20261122T233100.250Z`.
    pub started: String,
    /// How long it took.
    pub seconds: f64,
    /// What became of each stage; of one that several arms share, under each of its names.
    pub stages: BTreeMap<String, StageRun>,
    /// What it compared, if it had arms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub experiment: Option<Experiment>,
    /// The command line that it was begun with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
}

/// What became of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageRun {
    pub end: End,
    /// Its key, if all its inputs were known.
    pub key: Option<Digest>,
    /// Why it ran.
    pub reason: Option<String>,
    /// How long it took.
    pub seconds: f64,
}

impl StageRun {
    /// Its result was there.
    pub fn cached(key: Digest) -> Self {
        Self {
            end: End::Cached,
            key: Some(key),
            reason: None,
            seconds: 0.0,
        }
    }

    /// It never began.
    pub fn stopped() -> Self {
        Self {
            end: End::Stopped,
            key: None,
            reason: None,
            seconds: 0.0,
        }
    }
}

/// How a stage of a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// It was computed.
    Ran,
    /// Its result was there.
    Cached,
    Failed,
    /// It never began, or was stopped.
    Stopped,
}

impl RunRecord {
    /// Keeps it. A store that can only be read goes without.
    pub fn keep(&self, store: &Store) -> Result<(), StoreError> {
        if store.files.read_only {
            return Ok(());
        }
        // A run ends here, whichever way it ended: what it has found sound is kept for the next
        // one.
        store.cache.keep();
        let folder = store.files.root.join("runs");
        // On one line: there may be thousands of stages.
        let bytes = serde_json::to_vec(self)
            .map_err(std::io::Error::from)
            .at("write", &folder)?;
        // Two runs of a pipeline can begin in the same millisecond, on two hosts for example.
        // Neither record is lost.
        for number in 0.. {
            let again = if number == 0 {
                String::new()
            } else {
                format!("-{number}")
            };
            let path = folder.join(format!("{}-{}{again}.json", self.started, self.pipeline));
            if store.files.put_new(&path, &bytes)? {
                break;
            }
        }
        Ok(())
    }

    /// The runs of a pipeline (of all where no name is given), newest first, read one by one.
    pub fn past(
        store: &Store,
        pipeline: Option<&str>,
    ) -> Result<impl Iterator<Item = Self>, StoreError> {
        let folder = store.files.root.join("runs");
        let mut paths: Vec<PathBuf> = match std::fs::read_dir(&folder) {
            Ok(entries) => entries.flatten().map(|entry| entry.path()).collect(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error).at("read", &folder),
        };
        // The moment at the front has a fixed width, so the order of names is that of time.
        paths.sort_by(|a, b| b.file_stem().cmp(&a.file_stem()));
        let pipeline = pipeline.map(str::to_owned);
        // Read only when asked for: most callers want the newest of thousands. A garbled one is
        // left out.
        let runs = paths
            .into_iter()
            .filter_map(|path| read_json::<Self>(&path).ok().flatten());
        Ok(runs.filter(move |run| pipeline.as_ref().is_none_or(|name| *name == run.pipeline)))
    }
}

/// This moment in UTC: `20261122T233100.250Z`.
pub fn now() -> String {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let seconds = since.as_secs();
    let millis = since.subsec_millis();
    let (year, month, day) = civil(seconds / 86_400);
    let hour = seconds / 3600 % 24;
    let minute = seconds / 60 % 60;
    let second = seconds % 60;
    format!("{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}.{millis:03}Z")
}

/// The date of a day counted from 1970-01-01, in the Gregorian calendar. Years are counted from
/// March, so that leap days come last.
fn civil(days: u64) -> (u64, u64, u64) {
    // After Howard Hinnant's `civil_from_days`: 719 468 days lie between 0000-03-01 and 1970-01-01,
    // and 146 097 are 400 years.
    let days = days + 719_468;
    let era = days / 146_097;
    let day_of_era = days % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    // From March on, any five months have 153 days: 31, 30, 31, 30, 31.
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let (month, carry) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    (era * 400 + year_of_era + carry, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_dates() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(11_016), (2000, 2, 29));
        assert_eq!(civil(20_779), (2026, 11, 22));
    }

    #[test]
    fn runs_come_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::create(folder.path()).unwrap();
        let run = |pipeline: &str, started: &str| RunRecord {
            pipeline: pipeline.into(),
            started: started.into(),
            seconds: 1.0,
            stages: Default::default(),
            experiment: None,
            command: None,
        };
        for (pipeline, started) in [
            ("a", "20260101T000000.000Z"),
            ("b", "20260102T000000.000Z"),
            ("a", "20260103T000000.000Z"),
        ] {
            run(pipeline, started).keep(&store).unwrap();
        }
        let started: Vec<String> = RunRecord::past(&store, Some("a"))
            .unwrap()
            .map(|run| run.started)
            .collect();
        assert_eq!(started, ["20260103T000000.000Z", "20260101T000000.000Z"]);
        assert_eq!(RunRecord::past(&store, None).unwrap().count(), 3);
        assert_eq!(now().len(), started[0].len());
    }
}
