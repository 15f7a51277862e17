//! `metrics`: prints the scores of the last run.

use clap::Args;
use serde_json::{Value, json};

use super::options::Folders;
use super::output::{print, print_json};
use crate::error::Error;
use crate::report::{self, Scores};
use crate::store::Store;
use crate::store::result::Lookup;
use crate::store::runs::Run;

/// Options of `metrics`.
#[derive(Args)]
pub struct Metrics {
    /// The pipeline's name; by default that of the last run
    pipeline: Option<String>,
    #[command(flatten)]
    folders: Folders,
}

impl Metrics {
    /// Prints the scores.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let store = Store::open(&self.folders.store)?;
        let Some(run) = store.runs(self.pipeline.as_deref())?.next() else {
            let help = "run a pipeline first, or say where its store is: --store FOLDER";
            return Err(Error::usage("no run is recorded here", help));
        };
        let all = scores(&store, &run)?;
        if json {
            let stages: Vec<Value> = all.iter().map(entry).collect();
            print_json(&json!({"pipeline": run.pipeline, "run": run.started, "metrics": stages}));
        } else if all.is_empty() {
            print(&format_args!(
                "the run of {} at {} left no metrics",
                run.pipeline, run.started
            ));
        } else {
            let tables: Vec<String> = all.iter().map(Scores::table).collect();
            print(&tables.join("\n\n"));
        }
        Ok(())
    }
}

fn scores(store: &Store, run: &Run) -> Result<Vec<Scores>, Error> {
    let mut all = Vec::new();
    for (name, stage) in &run.stages {
        if let Some(key) = stage.key
            && let Lookup::Sound(record) = store.lookup(&key)?
        {
            all.extend(report::scores(store, name, &record)?);
        }
    }
    Ok(all)
}

fn entry(scores: &Scores) -> Value {
    let Scores {
        stage,
        output,
        metrics,
    } = scores;
    json!({"stage": stage, "output": output, "rows": metrics.rows, "definitions": metrics.definitions})
}
