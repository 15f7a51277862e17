//! `store du`: what takes the space.

use clap::Args;
use serde_json::json;

use crate::cli::error::Error;
use crate::cli::options::Folders;
use crate::store::Store;
use crate::store::usage::{Space, Usage};
use crate::terminal::output::{print, print_json, size, table};

/// Options of `store du`.
#[derive(Args)]
pub struct Du {
    #[command(flatten)]
    folders: Folders,
}

impl Du {
    /// Prints what takes the space.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let usage = Usage::of(&Store::open(&self.folders.store)?)?;
        if json {
            let stages: Vec<_> = usage.stages.iter().map(entry).collect();
            print_json(&json!({
                "stages": stages, "pipelines": usage.pipelines, "other_results": usage.others, "rest": usage.rest,
                "total": usage.total,
            }));
        } else {
            print(&table(&rows(&usage), true));
        }
        Ok(())
    }
}

fn entry((pipeline, stage, space): &(String, String, Space)) -> serde_json::Value {
    json!({"pipeline": pipeline, "stage": stage, "bytes": space.bytes, "own": space.own})
}

fn rows(usage: &Usage) -> Vec<Vec<String>> {
    let row = |name: String, space: &Space| vec![name, size(space.bytes), size(space.own)];
    let mut rows = vec![["", "size", "own"].map(str::to_owned).to_vec()];
    for (pipeline, space) in &usage.pipelines {
        rows.push(row(pipeline.clone(), space));
        let stages = usage.stages.iter().filter(|(of, ..)| of == pipeline);
        rows.extend(stages.map(|(_, stage, space)| row(format!("  {stage}"), space)));
    }
    rows.push(row("results of earlier runs".into(), &usage.others));
    rows.extend(
        usage
            .rest
            .iter()
            .map(|(name, bytes)| vec![(*name).to_owned(), size(*bytes)]),
    );
    rows.push(vec!["total".into(), size(usage.total)]);
    rows
}
