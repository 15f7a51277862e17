//! The arms of a run side by side: scores over seeds and views, what each has ahead of the
//! baseline, and what it took. Knows metrics only by what their definitions say, and prints
//! nothing.

mod format;
mod read;
mod rows;
pub mod statistics;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

pub use self::format::{TableFormat, percent};
use self::read::{ArmReader, Read};
use self::statistics::{Better, Paired, mean, paired, spread};
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::record::Record;
use crate::store::runs::RunRecord;

/// The arms of a run side by side.
#[derive(Serialize)]
pub struct Comparison {
    /// The pipeline's name.
    pub pipeline: String,
    /// When the run began.
    pub run: String,
    /// The arm that others are compared with.
    pub baseline: String,
    /// The arm that is the best that can be hoped for, if there is one.
    pub bound: Option<String>,
    /// The seeds of each arm.
    pub seeds: Vec<u64>,
    /// The metrics that any arm has.
    pub metrics: Vec<Metric>,
    /// The arms in the order of the file.
    pub arms: Vec<Scored>,
    /// What could not be computed of arms that have scores, and why.
    pub notes: Vec<String>,
}

/// A column.
#[derive(Serialize)]
pub struct Metric {
    pub name: String,
    /// What it measures.
    pub definition: String,
    /// Which way it is better, if either.
    pub better: Option<Better>,
}

/// An arm with its scores.
#[derive(Serialize)]
pub struct Scored {
    pub name: String,
    /// In what it differs from the pipeline's own stages.
    pub differences: BTreeMap<String, String>,
    /// Its scores by metric.
    pub scores: BTreeMap<String, Score>,
    /// Why it has no scores, if it has none.
    pub absent: Option<String>,
    /// What it took.
    pub cost: Cost,
    /// The scores of each run, by view and metric: one run for each seed that has scores.
    pub runs: Vec<Views>,
    /// The result that holds the scores of the first of these runs, and its pictures.
    #[serde(skip)]
    pub source: Option<Record>,
}

/// Scores by view, then by metric.
pub type Views = BTreeMap<String, BTreeMap<String, f64>>;

/// An arm's value of a metric.
#[derive(Serialize)]
pub struct Score {
    /// The mean over seeds of the mean over views.
    pub mean: f64,
    /// The standard deviation over seeds, of two or more.
    pub spread: Option<f64>,
    /// What it has ahead of the baseline, paired by view; of several seeds, each view's mean over
    /// them.
    pub difference: Option<Paired>,
    /// How far it is on the way from the low-resolution field (0) to the bound (1).
    pub gap_closed: Option<f64>,
}

/// What stages took when they were computed, whenever that was.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cost {
    /// Seconds of all its stages and seeds together; a stage that arms share counts for each.
    pub seconds: f64,
    /// The most memory that the program had while one of them ran, in bytes, where the system
    /// tells.
    pub peak_memory: Option<u64>,
    /// The same by stage, over all seeds.
    pub stages: BTreeMap<String, StageCost>,
}

/// What a stage took.
#[derive(Clone, Debug, Default, Serialize)]
pub struct StageCost {
    /// Seconds, over all seeds.
    pub seconds: f64,
    /// The most memory that the program had while it ran, in bytes.
    pub peak_memory: Option<u64>,
}

impl Comparison {
    /// Puts the arms of a run side by side; `None` if it had none.
    pub fn of(run: &RunRecord, store: &Store) -> Result<Option<Self>, StoreError> {
        let Some(experiment) = &run.experiment else {
            return Ok(None);
        };
        let mut reader = ArmReader::new(run, store, experiment);
        let arms = experiment
            .arms
            .iter()
            .map(|arm| reader.arm(arm))
            .collect::<Result<Vec<_>, _>>()?;
        // After all arms are read: definitions come with their scores.
        let metrics = metrics(&arms, &reader.definitions);
        let find = |name: &str| arms.iter().find(|read| read.arm.name == name);
        let baseline = find(&experiment.baseline);
        let bound = experiment.bound.as_deref().and_then(find);
        let scored = arms
            .iter()
            .map(|arm| scored(arm, baseline, bound, &metrics))
            .collect();
        Ok(Some(Self {
            pipeline: run.pipeline.clone(),
            run: run.started.clone(),
            baseline: experiment.baseline.clone(),
            bound: experiment.bound.clone(),
            seeds: experiment.seeds.clone(),
            metrics,
            arms: scored,
            notes: reader.notes(),
        }))
    }
}

/// The metrics that any arm has, the most telling first.
fn metrics(arms: &[Read], definitions: &BTreeMap<String, String>) -> Vec<Metric> {
    let views = arms.iter().flat_map(|arm| &arm.runs).flatten();
    let names: BTreeSet<&String> = views.flat_map(|(_, scores)| scores.keys()).collect();
    let mut metrics: Vec<Metric> = names
        .into_iter()
        .map(|name| {
            let definition = definitions.get(name).cloned().unwrap_or_default();
            Metric {
                name: name.clone(),
                better: Better::of(&definition),
                definition,
            }
        })
        .collect();
    metrics.sort_by_key(|metric| stages::metric_rank(&metric.name));
    metrics
}

/// The value of a metric for each view, over all runs.
fn by_view(runs: &[Views], metric: &str) -> BTreeMap<String, f64> {
    let mut values: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (view, scores) in runs.iter().flatten() {
        let of_view = values.entry(view.clone()).or_default();
        of_view.extend(scores.get(metric));
    }
    values
        .into_iter()
        .filter_map(|(view, values)| Some((view, mean(&values)?)))
        .collect()
}

/// The mean over views of a metric, for each run.
fn by_run(runs: &[Views], metric: &str) -> Vec<f64> {
    let of_run = |views: &Views| {
        let values: Vec<f64> = views
            .values()
            .filter_map(|of| of.get(metric).copied())
            .collect();
        mean(&values)
    };
    runs.iter().filter_map(of_run).collect()
}

fn scored(arm: &Read, baseline: Option<&Read>, bound: Option<&Read>, metrics: &[Metric]) -> Scored {
    let score = |metric: &Metric| {
        let values = by_run(&arm.runs, &metric.name);
        let mean = mean(&values)?;
        // An arm has nothing ahead of itself.
        let baseline = baseline.filter(|baseline| baseline.arm.name != arm.arm.name);
        Some(Score {
            mean,
            spread: spread(&values),
            difference: baseline
                .zip(metric.better)
                .and_then(|(baseline, better)| difference(arm, baseline, &metric.name, better)),
            gap_closed: bound
                .filter(|_| metric.better.is_some())
                .and_then(|bound| gap_closed(mean, &arm.floors, bound, &metric.name)),
        })
    };
    Scored {
        name: arm.arm.name.clone(),
        differences: arm.arm.differences.clone(),
        scores: metrics
            .iter()
            .filter_map(|metric| Some((metric.name.clone(), score(metric)?)))
            .collect(),
        absent: arm.absent.clone(),
        cost: arm.cost.clone(),
        runs: arm.runs.clone(),
        source: arm.source.clone(),
    }
}

impl Comparison {
    /// The arm that is best by a metric, the bound left out, and the next best.
    pub fn best(&self, metric: &Metric) -> Option<(&Scored, Option<&Scored>)> {
        let better = metric.better?;
        let mean = |arm: &Scored| arm.scores.get(&metric.name).map(|score| score.mean);
        let mut arms: Vec<(&Scored, f64)> = self
            .arms
            .iter()
            // The bound has been trained on what the others do not see, and would win by that.
            .filter(|arm| Some(&arm.name) != self.bound.as_ref())
            .filter_map(|arm| Some((arm, mean(arm)?)))
            .collect();
        // The sort is stable: of equal arms, the first in the file is the best.
        arms.sort_by(|(_, a), (_, b)| match better {
            Better::Higher => b.total_cmp(a),
            Better::Lower => a.total_cmp(b),
        });
        let mut arms = arms.into_iter().map(|(arm, _)| arm);
        Some((arms.next()?, arms.next()))
    }
}

impl Scored {
    /// What it has ahead of another arm, paired by view.
    pub fn ahead_of(&self, other: &Self, metric: &Metric) -> Option<Paired> {
        let own = by_view(&self.runs, &metric.name);
        let others = by_view(&other.runs, &metric.name);
        let pairs: Vec<(f64, f64)> = own
            .iter()
            .filter_map(|(view, value)| Some((*value, *others.get(view)?)))
            .collect();
        paired(&pairs, metric.better?)
    }

    /// The value of a metric for each view, over all runs.
    pub fn by_view(&self, metric: &str) -> BTreeMap<String, f64> {
        by_view(&self.runs, metric)
    }
}

fn difference(arm: &Read, baseline: &Read, metric: &str, better: Better) -> Option<Paired> {
    // Seeds of one view are no independent pairs: counted one by one, they would make the interval
    // too narrow. So each view has one value, its mean over seeds.
    let own = by_view(&arm.runs, metric);
    let others = by_view(&baseline.runs, metric);
    let pairs: Vec<(f64, f64)> = own
        .iter()
        .filter_map(|(view, value)| Some((*value, *others.get(view)?)))
        .collect();
    paired(&pairs, better)
}

/// `(x - floor) / (bound - floor)`, on means; `None` where the two are equal.
fn gap_closed(value: f64, floors: &[Views], bound: &Read, metric: &str) -> Option<f64> {
    let floor = mean(&by_run(floors, metric))?;
    let bound = mean(&by_run(&bound.runs, metric))?;
    let closed = (value - floor) / (bound - floor);
    // Where floor and bound are equal there is no way to go, and the share is infinite or no
    // number.
    closed.is_finite().then_some(closed)
}
