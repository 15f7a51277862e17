//! What a run or a plan is asked, as one digest, and what the answer that all results are there rests on. Knows nothing of the store's
//! files.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use artifacts_schema::Digest;
use compute::Device;

use super::options::{Choice, PipelineOptions};
use super::session::Session;
use crate::plan::Context;
use crate::report;
use crate::scheduler::Outcome;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::runs::End;
use crate::store::signature::Signature;
use crate::store::standing::Standing;
use crate::store::view::View;

/// Everything, but what lies in files, that decides what becomes of each stage; and this program and the pipeline's text. `None` where
/// more decides: what a remote has, or that something is computed whatever is there.
pub fn question(options: &PipelineOptions, choice: &Choice, device: &Device) -> Option<Digest> {
    let PipelineOptions { pipeline, changes } = options;
    if changes.remote.is_some() || !choice.force.is_empty() {
        return None;
    }
    let program = std::env::current_exe().ok()?;
    let text = blake3::hash(&std::fs::read(pipeline).ok()?);
    let places: Vec<PathBuf> = [Path::new("."), pipeline, &changes.folders.store, &changes.folders.out]
        .iter()
        .map(|path| std::path::absolute(path).ok())
        .collect::<Option<_>>()?;
    let words = (&changes.set, &changes.salt, &choice.target, device.kind());
    let parts = (Signature::at(&program)?, text.as_bytes(), places, words);
    Some(blake3::hash(&serde_json::to_vec(&parts).ok()?).into())
}

/// The answer in a store that all results are there, if it still stands; it does for as long as the store which comes with it lives.
pub fn find(question: Option<&Digest>, store: &Path) -> Result<Option<(Store, Standing)>, StoreError> {
    let Some(question) = question else { return Ok(None) };
    let mut store = Store::open(store)?;
    store.share_if_there();
    Ok(store.standing(question).map(|standing| (store, standing)))
}

/// Keeps for the next run that this one had nothing to do, if so it was.
pub fn keep(
    question: &Digest,
    (session, context, store): (&Session, &Context, &Store),
    outcome: &Outcome,
    view: &View,
    since: SystemTime,
) {
    let is_whole = outcome.stages.values().all(|stage| stage.end == End::Cached) && !outcome.interrupted;
    let Some(mut files) = is_whole.then(|| session.source_files(context)).flatten() else { return };
    files.insert(view.list());
    let name = |at: &usize| context.graph.nodes[*at].name.clone();
    for (at, record) in &outcome.records {
        files.extend(store.evidence(record, |output| view.output(&context.graph.nodes[*at].name, output)));
    }
    let told = outcome.records.iter().filter(|(_, record)| report::tells(record));
    let standing = Standing {
        pipeline: context.graph.pipeline.clone(),
        stages: outcome.records.iter().map(|(at, record)| (name(at), record.key)).collect(),
        told: told.map(|(at, record)| (name(at), record.clone())).collect(),
    };
    store.put_standing(question, standing, files, since);
}
