//! `run --only STAGE`: one stage whose inputs are in the store. What a job of a batch system calls;
//! `export` writes such jobs.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::error::Error;
use super::session::Session;
use super::whole;
use crate::runner::plan::{Context, Forecast};
use crate::store::error::{At, StoreError};
use crate::store::record::Record;

/// Which single stage to run.
#[derive(Args)]
pub struct Only {
    /// Only this stage (or shard): the results that it reads must be in the store
    #[arg(long, value_name = "STAGE", conflicts_with = "target")]
    only: Option<String>,
    /// With --only: where to leave the digests of the stage's outputs when it has them
    #[arg(long, value_name = "FILE", requires = "only")]
    stamp: Option<PathBuf>,
}

impl Only {
    /// Whether all stages are meant.
    pub fn is_all(&self) -> bool {
        self.only.is_none()
    }

    /// The one stage, if there is to be only one.
    pub fn stage(&self, session: &Session) -> Result<Option<usize>, Error> {
        self.only
            .as_deref()
            .map(|name| session.stage(name))
            .transpose()
    }

    /// Leaves nothing to be computed but this stage; an error if something before it has no result.
    /// What it reads is fetched if it is only in the remote; of what lies before that the records
    /// suffice.
    pub fn narrow(&self, context: &mut Context, stage: usize) -> Result<(), Error> {
        context.needed = context.graph.needed(&BTreeSet::from([stage]));
        // A stage upstream that was forced would count as one without a result.
        context.forced.retain(|&forced| forced == stage);
        let mut forecasts = context.forecast()?;
        let name = |at: usize| context.graph.nodes[at].name.clone();
        let missing = |at: usize| Error::NoInput {
            stage: name(stage),
            missing: name(at),
        };
        if let Some((&at, _)) = forecasts
            .iter()
            .find(|(at, forecast)| **at != stage && !forecast.is_cached())
        {
            return Err(missing(at));
        }
        let mut given = BTreeMap::new();
        for wire in &context.graph.nodes[stage].wires {
            let Some(Forecast::Cached(assessment)) = forecasts.remove(&wire.from) else {
                continue;
            };
            let found = match (context.remote, assessment.is_remote) {
                (Some(remote), true) => remote
                    .fetch(context.store, &assessment.key)?
                    .map(|(record, _)| record),
                _ => assessment.verdict.ok(),
            };
            given.insert(wire.from, found.ok_or_else(|| missing(wire.from))?);
        }
        // Only now that the forecast is made, which needs the stages before this one for its key.
        context.needed = BTreeSet::from([stage]);
        context.given = given;
        Ok(())
    }

    /// Writes the stamp: the same bytes as before if the outputs are.
    pub fn stamp(&self, stage: &str, record: Option<&Record>) -> Result<(), StoreError> {
        let (Some(path), Some(record)) = (&self.stamp, record) else {
            return Ok(());
        };
        let outputs = record
            .outputs
            .iter()
            .map(|(name, output)| (name.clone(), json!(output.digest)));
        let stamp =
            json!({ "stage": stage, "outputs": outputs.collect::<serde_json::Map<_, _>>() });
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).at("create", folder)?;
        // Snakemake takes a stamp that is there for a job that is done, so it must never be half
        // written.
        let mut file = whole::beside(path).at("write", path)?;
        writeln!(file, "{stamp}").at("write", path)?;
        file.persist(path)
            .map_err(|error| error.error)
            .at("write", path)?;
        Ok(())
    }
}
