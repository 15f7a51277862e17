//! What `run` says when it ends: tables, pictures, how long it took, and which arms failed. Knows
//! outcomes, and computes nothing.

use std::fmt::Write;

use serde_json::json;

use crate::cli::error::Error;
use crate::pipeline::graph::Graph;
use crate::report::comparison::{Comparison, TableFormat};
use crate::report::results;
use crate::runner::scheduler::Outcome;
use crate::runner::task::Failure;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::record::Record;
use crate::store::runs::{End, RunRecord};
use crate::store::view::View;
use crate::terminal::output::{print, tell};
use crate::terminal::progress::{Verbosity, duration};

/// A run that has ended, and how to speak of it.
pub struct Ending<'a> {
    /// What is kept of it.
    pub run: &'a RunRecord,
    /// Where its results are.
    pub store: &'a Store,
    /// Where people find them.
    pub view: &'a View,
    /// How much is said.
    pub verbosity: Verbosity,
    /// Whether it is said as an event.
    pub json: bool,
}

impl Ending<'_> {
    /// Says it. `ended` is how each stage ended, by name.
    pub fn tell<'r>(
        &self,
        ended: &[(&str, End)],
        results: impl Iterator<Item = (&'r str, &'r Record)> + Clone,
    ) -> Result<(), StoreError> {
        let names = |end| names(ended, end);
        if self.json {
            print(&json!({
                "event": "finished",
                "ran": names(End::Ran), "cached": names(End::Cached), "failed": names(End::Failed),
                "stopped": names(End::Stopped), "seconds": self.run.seconds,
            }));
            return Ok(());
        }
        let tables = match Comparison::of(self.run, self.store)? {
            Some(comparison) => comparison.tables(TableFormat::Text),
            None => tables(self.store, results.clone())?,
        };
        for table in tables {
            print(&format_args!("\n{table}"));
        }
        let figures: Vec<_> = results
            .flat_map(|(stage, result)| results::figures(self.view, stage, result))
            .collect();
        if self.run.experiment.is_some() {
            let report = format!("srnerf-dag report {} -o report.html", self.run.pipeline);
            print(&format_args!("\nPictures side by side: {report}"));
        } else if !figures.is_empty() {
            print(&format_args!(
                "\nPictures: {}",
                figures.join("\n          ")
            ));
        }
        if self.verbosity > Verbosity::Quiet {
            let ran = names(End::Ran).len();
            let cached = names(End::Cached).len();
            let stages = if ran == 1 { "stage" } else { "stages" };
            tell(&format_args!(
                "\n{ran} {stages} ran, {cached} cached, in {}",
                duration(self.run.seconds)
            ));
        }
        Ok(())
    }
}

/// The tables of all results, one after the other.
fn tables<'r>(
    store: &Store,
    results: impl Iterator<Item = (&'r str, &'r Record)>,
) -> Result<Vec<String>, StoreError> {
    let mut all = Vec::new();
    for (stage, result) in results {
        all.extend(results::tables(store, stage, result)?);
    }
    Ok(all)
}

fn names<'n>(ended: &[(&'n str, End)], end: End) -> Vec<&'n str> {
    ended
        .iter()
        .filter(|(_, its)| *its == end)
        .map(|(name, _)| *name)
        .collect()
}

/// The error that a run ends with, if any.
pub fn verdict(outcome: &Outcome, graph: &Graph) -> Result<(), Error> {
    let count = outcome.failures.len();
    let stages = if count == 1 { "stage" } else { "stages" };
    let message = format!("{count} {stages} failed{}", failed_arms(outcome, graph));
    let any = |is: fn(&Failure) -> bool| outcome.failures.iter().any(|(_, failure)| is(failure));
    // The gravest decides the exit code: a script must not take a bug for a bad parameter.
    if any(|failure| matches!(failure, Failure::Bug(_))) {
        Err(Error::Bug(message))
    } else if any(|failure| matches!(failure, Failure::Store(_))) {
        Err(Error::FailedStore(message))
    } else if count > 0 {
        Err(Error::Failed(message))
    } else if outcome.interrupted {
        Err(Error::Interrupted)
    } else {
        Ok(())
    }
}

/// The arms that failed, each with the stage that failed and why: it was said hours ago.
fn failed_arms(outcome: &Outcome, graph: &Graph) -> String {
    let mut lines = String::new();
    for (at, failure) in &outcome.failures {
        let node = &graph.nodes[*at];
        for arm in node.arms() {
            let _ = write!(lines, "\n  arm {arm}: {}: {}", node.name, failure.text());
        }
    }
    lines
}
