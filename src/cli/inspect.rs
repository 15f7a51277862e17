//! `inspect`: says what is in a file, or what a stage left. Writes nothing.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::Path;

use artifacts_schema::{Artifact, Field};
use clap::Args;
use serde_json::{Value, json};
use stages::convert;

use super::error::Error;
use super::options::{Choice, PipelineOptions};
use super::session::Session;
use crate::content::Content;
use crate::store::Store;
use crate::store::record::Record;
use crate::store::view::View;
use crate::terminal::output::{print, print_json, size, table};

#[derive(Args)]
pub struct Inspect {
    /// A file (.exr, .safetensors, .json) or a stage of the pipeline
    what: String,
    #[command(flatten)]
    pipeline: PipelineOptions,
}

impl Inspect {
    /// Prints what there is to say.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let path = Path::new(&self.what);
        // Names of stages have dots too, but never one of these endings.
        if path.is_file() || Content::can_read(path) {
            file(path, json)
        } else {
            self.stage(json)
        }
    }

    fn stage(&self, json: bool) -> Result<(), Error> {
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        let session = Session::new(pipeline, changes, &Choice::default())?;
        let at = session.stage(&self.what)?;
        let store = Store::open(&changes.folders.store)?;
        let mut context = session.context(&store);
        // Only what its key depends on: the results of other stages need not be looked up.
        context.needed = session.graph.needed(&BTreeSet::from([at]));
        let mut forecasts = context.forecast()?;
        let name = &session.graph.nodes[at].name;
        let record = forecasts
            .remove(&at)
            .and_then(|forecast| forecast.into_record());
        let Some(record) = record else {
            let help = "run it first, with the same --set, --salt and --store";
            return Err(Error::usage(format!("stage `{name}` has no result"), help));
        };
        let view = View::new(&changes.folders.out, &session.graph.pipeline);
        if json {
            print_json(&json!(record))
        } else {
            outputs(name, &record, &view)
        }
        Ok(())
    }
}

fn outputs(name: &str, record: &Record, view: &View) {
    print(&format_args!(
        "{name}\nkey {}\ncomputed in {:.1} s on {}",
        record.key, record.seconds, record.device
    ));
    for remark in &record.remarks {
        print(&format_args!("warning: {remark}"));
    }
    for (output, artifact) in &record.outputs {
        let folder = view.output(name, output);
        print(&format_args!(
            "\n{output}: {}, {}\nin {}",
            artifact.kind,
            artifact.digest,
            folder.display()
        ));
        let row = |file: &crate::store::record::StoredFile| {
            vec![format!("  {}", file.path), size(file.bytes)]
        };
        print(&table(
            &artifact.files.iter().map(row).collect::<Vec<_>>(),
            true,
        ));
    }
}

fn file(path: &Path, json: bool) -> Result<(), Error> {
    let mut content = Content::read(path).map_err(|problem| {
        let help = "inspect reads .exr, .safetensors and .json files, and stages of the pipeline";
        Error::usage(format!("{}: {problem}", path.display()), help)
    })?;
    content.facts.extend(field_facts(path));
    if json {
        print_json(&content.json());
        return Ok(());
    }
    print(&path.display());
    let head = ["name", "shape", "type", "least", "mean", "most"]
        .map(str::to_owned)
        .to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(head)
        .chain(content.arrays.iter().map(|array| array.row()))
        .collect();
    if rows.len() > 1 {
        print(&table(&rows, true));
    }
    let facts = content
        .facts
        .iter()
        .flat_map(|(name, value)| lines(name, value))
        .collect::<Vec<_>>();
    print(&table(&facts, false));
    Ok(())
}

/// What the tensors of a field mean: how full its box is, and the Euclidean norms of its
/// parameters. Nothing for other files.
fn field_facts(path: &Path) -> Vec<(String, Value)> {
    let folder = path
        .parent()
        .filter(|_| path.file_name() == Some(OsStr::new("field.safetensors")));
    let Some(field) = folder.and_then(|folder| Field::read(folder).ok()) else {
        return Vec::new();
    };
    // Squares are summed in f64: in a table of millions of entries, an f32 sum would stop growing.
    let norm = |values: &[f32]| {
        values
            .iter()
            .map(|value| f64::from(*value).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let parameters = field
        .tensors
        .iter()
        // No gradient trains the occupancy, so it is no parameter and its norm means nothing.
        .filter(|(name, _)| !name.starts_with("occupancy"));
    let norms: serde_json::Map<_, _> = parameters
        .map(|(name, tensor)| (name.clone(), json!(norm(&tensor.values))))
        .collect();
    let mut facts = vec![("norms".to_owned(), Value::Object(norms))];
    if let Ok(field) = convert::field(field) {
        let full = field.occupancy_counts();
        let part = |count: usize| count as f64 / full.cells as f64;
        let occupancy = json!({"cells": full.cells, "seen_by_cameras": part(full.seen), "occupied": part(full.occupied)});
        facts.push(("occupancy".to_owned(), occupancy));
    }
    facts
}

/// Nested facts as one line for each value: `provenance.stage  fit`.
fn lines(name: &str, value: &Value) -> Vec<Vec<String>> {
    match value {
        Value::Object(fields) if !fields.is_empty() => fields
            .iter()
            .flat_map(|(field, value)| lines(&format!("{name}.{field}"), value))
            .collect(),
        Value::String(text) => vec![vec![name.to_owned(), text.clone()]],
        other => vec![vec![name.to_owned(), other.to_string()]],
    }
}
