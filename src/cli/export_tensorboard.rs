//! `export tensorboard`: the curves and scores of the last run, for TensorBoard. Writes one folder,
//! with a folder for each stage.

use std::fs;
use std::path::{Path, PathBuf};

use artifacts_schema::Log;
use clap::Args;
use serde_json::json;

use super::error::Error;
use super::metrics::last_run;
use super::options::Folders;
use crate::export::tensorboard::{Events, FILE};
use crate::report::results::{self, Scores};
use crate::store::Store;
use crate::store::results::Lookup;
use crate::terminal::output::{print, print_json};

/// Options of `export tensorboard`.
#[derive(Args)]
pub struct TensorBoard {
    /// The pipeline's name; by default that of the last run
    pipeline: Option<String>,
    /// The folder to write, for `tensorboard --logdir`; files of an earlier export are replaced
    #[arg(short, long, value_name = "FOLDER", default_value = "tensorboard")]
    output: PathBuf,
    #[command(flatten)]
    folders: Folders,
}

impl TensorBoard {
    /// Writes a file for each stage that has a log or metrics.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let store = Store::open(&self.folders.store)?;
        let run = last_run(&store, self.pipeline.as_deref())?;
        let mut written = Vec::new();
        for (name, stage) in &run.stages {
            let Some(key) = stage.key else {
                continue;
            };
            let Lookup::Sound(record) = store.results.lookup(&key)? else {
                continue;
            };
            let log = results::log(&store, &record)?;
            let scores = results::scores(&store, name, &record)?;
            // A stage with neither log nor scores gets no folder, which TensorBoard would list as a
            // run.
            if let Some(events) = events(&log, &scores) {
                write(&self.output.join(name), events.bytes())?;
                written.push(name);
            }
        }
        match json {
            true => print_json(&json!({"folder": self.output, "stages": written})),
            false => print(&format_args!(
                "wrote {} stages; tensorboard --logdir {}",
                written.len(),
                self.output.display()
            )),
        }
        Ok(())
    }
}

/// A log's figures by their names, and each row of metrics as `ROW/METRIC` at step 0.
fn events(log: &Log, scores: &[Scores]) -> Option<Events> {
    let mut events = Events::new();
    let mut any = false;
    for line in log.lines.iter().filter_map(|line| line.as_object()) {
        // TensorBoard draws values over steps. A line of a log without one has no place there.
        let Some(step) = line.get("step").and_then(|step| step.as_u64()) else {
            continue;
        };
        let figures = line.iter().filter(|(name, _)| *name != "step");
        let figures = figures.filter_map(|(name, value)| Some((name.as_str(), value.as_f64()?)));
        events.step(step, figures);
        any = true;
    }
    for (row, row_scores) in scores.iter().flat_map(|scores| &scores.metrics.rows) {
        let tagged = row_scores.mean.iter();
        let tagged: Vec<(String, f64)> = tagged
            .map(|(metric, value)| (format!("{row}/{metric}"), *value))
            .collect();
        // Scores belong to no step of a training.
        events.step(0, tagged.iter().map(|(tag, value)| (tag.as_str(), *value)));
        any = true;
    }
    any.then_some(events)
}

fn write(folder: &Path, bytes: &[u8]) -> Result<(), Error> {
    let made = fs::create_dir_all(folder);
    let written = made.and_then(|()| fs::write(folder.join(FILE), bytes));
    written.map_err(|error| {
        Error::usage(
            format!("cannot write to {}: {error}", folder.display()),
            "choose another place: -o FOLDER",
        )
    })
}
