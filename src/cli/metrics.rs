//! `metrics`: prints the scores of the last run; of one that had arms, side by side.

use clap::Args;
use serde_json::{Value, json};

use super::error::Error;
use super::options::Folders;
use crate::report::comparison::{Comparison, TableFormat};
use crate::report::results::{self, Scores};
use crate::store::Store;
use crate::store::results::Lookup;
use crate::store::runs::RunRecord;
use crate::terminal::output::{print, print_json};

#[derive(Args)]
pub struct Metrics {
    /// The pipeline's name; by default that of the last run
    pipeline: Option<String>,
    /// How to write tables down; of a run without arms, text or JSON
    #[arg(long, value_enum)]
    format: Option<TableFormat>,
    /// Of a run with arms: only the parameters in which they differ
    #[arg(long)]
    diff_only: bool,
    #[command(flatten)]
    folders: Folders,
}

impl Metrics {
    /// Prints the scores.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let store = Store::open(&self.folders.store)?;
        let run = last_run(&store, self.pipeline.as_deref())?;
        let default = if json {
            TableFormat::Json
        } else {
            TableFormat::Text
        };
        let format = self.format.unwrap_or(default);
        match Comparison::of(&run, &store)? {
            Some(comparison) if self.diff_only => print(&comparison.parameters(format)),
            Some(comparison) => print(&comparison.tables(format).join("\n\n")),
            None if self.diff_only => {
                let help = "arms are named sets of differences in a pipeline file (docs/cli.md)";
                return Err(Error::usage("this run had no arms to compare", help));
            }
            None => print_plain(&scores(&store, &run)?, &run, format)?,
        }
        Ok(())
    }
}

/// The last run of a pipeline, or of any.
pub fn last_run(store: &Store, pipeline: Option<&str>) -> Result<RunRecord, Error> {
    let help = "run a pipeline first, or say where its store is: --store FOLDER";
    let run = RunRecord::past(store, pipeline)?.next();
    run.ok_or_else(|| Error::usage("no run is recorded here", help))
}

fn print_plain(all: &[Scores], run: &RunRecord, format: TableFormat) -> Result<(), Error> {
    match format {
        TableFormat::Json => {
            let stages: Vec<Value> = all.iter().map(entry).collect();
            print_json(&json!({"pipeline": run.pipeline, "run": run.started, "metrics": stages}));
        }
        TableFormat::Text if all.is_empty() => print(&format_args!(
            "the run of {} at {} left no metrics",
            run.pipeline, run.started
        )),
        TableFormat::Text => {
            let tables: Vec<String> = all.iter().map(Scores::table).collect();
            print(&tables.join("\n\n"));
        }
        TableFormat::Md | TableFormat::Csv | TableFormat::Latex => {
            let help = "a run without arms has text and JSON: leave --format out, or take json";
            return Err(Error::usage("this format is for comparisons of arms", help));
        }
    }
    Ok(())
}

fn scores(store: &Store, run: &RunRecord) -> Result<Vec<Scores>, Error> {
    let mut all = Vec::new();
    for (name, stage) in &run.stages {
        // A result may be gone or damaged since that run. The others still have their scores.
        if let Some(key) = stage.key
            && let Lookup::Sound(record) = store.results.lookup(&key)?
        {
            all.extend(results::scores(store, name, &record)?);
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
    json!({
        "stage": stage, "output": output, "rows": metrics.rows,
        "definitions": metrics.definitions, "absent": metrics.absent,
    })
}
