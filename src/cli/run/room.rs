//! Whether a run's stages will fit into the memory that there is, before any of them begins.

use std::collections::BTreeMap;

use crate::cli::error::Error;
use crate::runner::plan::{Basis, Context, Cost, Experience, Forecast, Found};
use crate::store::error::StoreError;
use crate::store::record::Record;
use crate::terminal::output::size;

/// Refuses a run of which a stage will need more than `limit` bytes; `cached` are the results that
/// are there.
pub fn check(context: &Context, cached: &[Found], limit: u64) -> Result<(), Error> {
    let too_large = too_large(context, cached, limit)?;
    if too_large.is_empty() {
        return Ok(());
    }
    // Some may be fetched, or spared: of those nobody knows yet.
    let forecasts = context.forecast()?;
    let runs = |at: &usize| matches!(forecasts.get(at), Some(Forecast::Run(..)));
    match too_large.iter().find(|(at, _)| runs(at)) {
        Some((&at, cost)) => Err(refusal(&context.graph.nodes[at].name, cost, limit)),
        None => Ok(()),
    }
}

fn too_large(
    context: &Context,
    cached: &[Found],
    limit: u64,
) -> Result<BTreeMap<usize, Cost>, StoreError> {
    let there: BTreeMap<usize, &Record> = cached
        .iter()
        .map(|found| (found.at, &found.record))
        .collect();
    let missing = context.needed.iter().filter(|at| !there.contains_key(at));
    let missing: Vec<usize> = missing.copied().collect();
    if missing.is_empty() {
        return Ok(BTreeMap::new());
    }
    // Read only when something has to be computed: it means reading thousands of records.
    let experience = Experience::of(context.store)?;
    // With `--only`, results of stages that are no part of the run are given to it.
    let record = |at: usize| there.get(&at).copied().or_else(|| context.given.get(&at));
    let expected = context.expected(&missing, record);
    let costs = missing
        .into_iter()
        .map(|at| (at, context.cost(at, &experience, &expected)));
    Ok(costs.filter(|(_, cost)| cost.memory > limit).collect())
}

fn refusal(stage: &str, cost: &Cost, limit: u64) -> Error {
    let why = match &cost.basis {
        Basis::Result { stage } => format!("`{stage}`, with the same parameters, took so much"),
        Basis::Like { stage, but } => {
            format!("`{stage}`, with another {}, took so much", but.join(", "))
        }
        Basis::Guess => "a rough guess by its parameters and the sizes of what it reads".to_owned(),
    };
    Error::NoRoom {
        stage: stage.to_owned(),
        needed: size(cost.memory),
        why,
        there: size(limit),
    }
}
