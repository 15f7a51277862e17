//! What a run left of each of its arms: scores, reasons why there are none, and cost. Compares
//! nothing.

use std::collections::BTreeMap;

use artifacts_schema::{ArtifactKind, Digest, Metrics};

use super::{Cost, Views};
use crate::pipeline::experiment::{Arm, Experiment};
use crate::report::results;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::record::{Output, Record};
use crate::store::runs::{End, RunRecord, StageRun};

/// What is read of an arm before it is compared.
pub struct Read {
    pub arm: Arm,
    /// Its scores, by run.
    pub runs: Vec<Views>,
    /// The same metrics of the low-resolution field, by run.
    pub floors: Vec<Views>,
    /// Why it has no scores, if it has none.
    pub absent: Option<String>,
    /// What it took.
    pub cost: Cost,
    /// The result that holds the scores of its first run.
    pub source: Option<Record>,
}

/// The row of the low-resolution field, at which [`super::Score::gap_closed`] is 0.
const FLOOR: &str = "lr_nerf";

/// Reads what a run left of each arm.
pub struct ArmReader<'a> {
    run: &'a RunRecord,
    store: &'a Store,
    experiment: &'a Experiment,
    /// Results that were looked up, of stages that several arms share.
    records: BTreeMap<Digest, Option<Record>>,
    /// What the metrics that were read say of themselves.
    pub definitions: BTreeMap<String, String>,
    /// The arms of which something could not be computed, by what and why.
    lacks: BTreeMap<String, Vec<String>>,
}

impl<'a> ArmReader<'a> {
    /// Before the first arm.
    pub fn new(run: &'a RunRecord, store: &'a Store, experiment: &'a Experiment) -> Self {
        Self {
            run,
            store,
            experiment,
            records: BTreeMap::new(),
            definitions: BTreeMap::new(),
            lacks: BTreeMap::new(),
        }
    }

    /// Reads an arm.
    pub fn arm(&mut self, arm: &Arm) -> Result<Read, StoreError> {
        let mut read = Read {
            arm: arm.clone(),
            runs: Vec::new(),
            floors: Vec::new(),
            absent: None,
            cost: Cost::default(),
            source: None,
        };
        for folder in self.experiment.folders(&arm.name) {
            match self.folder(&folder, &mut read)? {
                Some(why) => read.absent = read.absent.or(Some(why)),
                None => continue,
            }
        }
        // An arm with scores is not absent: that some of its seeds have none becomes a note.
        if !read.runs.is_empty() {
            let lacks = read.absent.take().map(|why| (why, Vec::new()));
            self.lacks.extend(lacks);
        }
        Ok(read)
    }

    /// Reads one run of an arm; says why it has no scores if it has none.
    fn folder(&mut self, folder: &str, read: &mut Read) -> Result<Option<String>, StoreError> {
        let within = format!("{folder}/");
        let stages: Vec<(&str, &StageRun)> = self
            .run
            .stages
            // With the slash, so that `ours` does not take the stages of `ours_long`.
            .range(within.clone()..)
            .map_while(|(name, stage)| Some((name.strip_prefix(&within)?, stage)))
            .collect();
        let mut found = false;
        for (stage, run) in &stages {
            let Some(record) = self.record(run)? else {
                continue;
            };
            read.cost.add(stage, &record);
            // The first stage that has the row: an arm has one score, whatever else was measured in
            // it.
            if !found && let Some(metrics) = self.metrics(&record)? {
                self.keep(&read.arm.name, &metrics, read.runs.len());
                read.runs
                    .push(metrics.rows[&self.experiment.row].views.clone());
                let floor = metrics.rows.get(FLOOR);
                read.floors.extend(floor.map(|floor| floor.views.clone()));
                read.source = read.source.take().or(Some(record));
                found = true;
            }
        }
        Ok((!found).then(|| self.why_absent(folder, &stages)))
    }

    fn record(&mut self, stage: &StageRun) -> Result<Option<Record>, StoreError> {
        let Some(key) = stage.key else {
            return Ok(None);
        };
        if !self.records.contains_key(&key) {
            let record = self.store.results.lookup(&key)?.sound();
            self.records.insert(key, record);
        }
        Ok(self.records[&key].clone())
    }

    /// The metrics of a result that have the row by which arms are compared.
    fn metrics(&self, record: &Record) -> Result<Option<Metrics>, StoreError> {
        let is_metrics = |output: &&Output| output.kind == ArtifactKind::Metrics;
        if record.outputs.values().find(is_metrics).is_none() {
            return Ok(None);
        }
        let all = results::scores(self.store, &record.stage, record)?;
        let has_row = |metrics: &Metrics| metrics.rows.contains_key(&self.experiment.row);
        Ok(all.into_iter().map(|scores| scores.metrics).find(has_row))
    }

    fn keep(&mut self, arm: &str, metrics: &Metrics, run: usize) {
        self.definitions.extend(metrics.definitions.clone());
        let absent = metrics
            .absent
            .get(&self.experiment.row)
            // Of several seeds the first speaks, or an arm would be named once for each.
            .filter(|_| run == 0);
        for (metric, why) in absent.into_iter().flatten() {
            let arms = self.lacks.entry(format!("no {metric}: {why}"));
            arms.or_default().push(arm.to_owned());
        }
    }

    /// What is lacking, with the arms that lack it where others do not.
    pub fn notes(&self) -> Vec<String> {
        let note = |(what, arms): (&String, &Vec<String>)| match arms.len() {
            few if few > 0 && few < self.experiment.arms.len() => {
                format!("{what} ({})", arms.join(", "))
            }
            _ => what.clone(),
        };
        self.lacks.iter().map(note).collect()
    }

    fn why_absent(&self, folder: &str, stages: &[(&str, &StageRun)]) -> String {
        let with = |end: End| stages.iter().find(|(_, stage)| stage.end == end);
        if stages.is_empty() {
            format!("{folder}: not part of this run")
        } else if let Some((stage, _)) = with(End::Failed) {
            format!("{folder}: its stage {stage} failed")
        } else if let Some((stage, _)) = with(End::Stopped) {
            format!("{folder}: its stage {stage} did not run")
        } else {
            format!("{folder}: no stage gives the row {}", self.experiment.row)
        }
    }
}
impl Cost {
    fn add(&mut self, stage: &str, record: &Record) {
        self.seconds += record.seconds;
        // `None` is less than any number, so what is known counts.
        self.peak_memory = self.peak_memory.max(record.peak_memory);
        let of_stage = self.stages.entry(stage.to_owned()).or_default();
        of_stage.seconds += record.seconds;
        of_stage.peak_memory = of_stage.peak_memory.max(record.peak_memory);
    }
}
