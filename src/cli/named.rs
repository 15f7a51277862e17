//! Fields as a command line names them: by a path, by a run, or by a pipeline. Writes nothing.

use std::path::Path;

use super::diff::find_run;
use super::error::Error;
use super::metrics::last_run;
use crate::content::lineage::{Lineage, Told, last_fields};
use crate::store::Store;
use crate::store::runs::RunRecord;

/// The field that `what` names; of a run with several, that of a stage.
pub fn field(
    what: &str,
    stage: Option<&str>,
    store: &Store,
    lineage: &Lineage,
) -> Result<Told, Error> {
    let path = Path::new(what);
    if path.exists() {
        return read(path);
    }
    let run = run(what, store)?;
    let fields = last_fields(&run, store)?;
    let chosen = match stage {
        Some(stage) => fields.get(stage),
        None if fields.len() == 1 => fields.values().next(),
        None => None,
    };
    let Some(output) = chosen else {
        let names: Vec<&str> = fields.keys().map(String::as_str).collect();
        let message = format!(
            "the run of {} has {} such fields",
            run.pipeline,
            names.len()
        );
        let help = format!("name one with --stage: {}", names.join(", "));
        return Err(Error::usage(message, help));
    };
    Ok(lineage.field(output)?)
}

/// A field by its path.
pub fn read(path: &Path) -> Result<Told, Error> {
    let help = "give a field: field.safetensors, or its folder";
    Told::read(path).map_err(|problem| Error::usage(problem, help))
}

fn run(what: &str, store: &Store) -> Result<RunRecord, Error> {
    let runs: Vec<RunRecord> = RunRecord::past(store, None)?.collect();
    // For its error, which says that no run is recorded here.
    if runs.is_empty() {
        return last_run(store, None);
    }
    let of_pipeline = |run: &&RunRecord| run.pipeline == what;
    // Of a pipeline's name the newest run is meant, and runs come newest first.
    let found = find_run(&runs, what).or_else(|| runs.iter().find(of_pipeline));
    found.cloned().ok_or_else(|| {
        let message = format!("`{what}` is no field, no run and no pipeline");
        let help = "give field.safetensors or its folder, or @1, the last run";
        Error::usage(message, help)
    })
}
