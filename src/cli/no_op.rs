//! No-op runs: what a run or a plan is asked, as one digest, and what the answer that all results
//! are there rests on: of a run also that they are shown. Knows nothing of the store's files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use artifacts_schema::Digest;
use compute::Device;

use super::options::{Choice, PipelineOptions};
use super::session::Session;
use crate::pipeline::{self, problem::SourceText};
use crate::report::results;
use crate::runner::plan::{Context, Forecast};
use crate::runner::scheduler::Outcome;
use crate::store::Store;
use crate::store::cache::no_op::UpToDate;
use crate::store::cache::signature::Signature;
use crate::store::error::StoreError;
use crate::store::evidence;
use crate::store::record::Record;
use crate::store::runs::End;
use crate::store::view::View;

/// A digest of what decides what becomes of each stage: the options, this program, and the texts of
/// the pipeline and of the files that it extends. What lies in other files is no part of it. `None`
/// where more decides: what a remote has, or that something is computed whatever is there.
pub fn question(options: &PipelineOptions, choice: &Choice, device: &Device) -> Option<Digest> {
    let PipelineOptions {
        pipeline: path,
        changes,
    } = options;
    if changes.remote.is_some() || !choice.force.is_empty() {
        return None;
    }
    // Another build may compute other keys or look at other things, even under one version.
    let program = std::env::current_exe().ok()?;
    let files = pipeline::with_bases(SourceText::read(path).ok()?).ok()?;
    let texts: Vec<_> = files
        .iter()
        .map(|file| *blake3::hash(file.text.as_bytes()).as_bytes())
        .collect();
    // The working folder counts, since paths in the pipeline start from it.
    let places: Vec<PathBuf> = [
        Path::new("."),
        path,
        &changes.folders.store,
        &changes.folders.out,
    ]
    .iter()
    .map(|path| std::path::absolute(path).ok())
    .collect::<Option<_>>()?;
    let words = (
        &changes.set,
        &changes.salt,
        &choice.target,
        &choice.arm,
        device.kind(),
        &changes.fallback,
    );
    let parts = (Signature::at(&program)?, texts, places, words);
    Some(blake3::hash(&serde_json::to_vec(&parts).ok()?).into())
}

/// What a plan is asked, by what a run is.
pub fn of_plan(question: &Digest) -> Digest {
    // A question of its own: a plan looks at less than a run, which must not take its answer.
    blake3::hash(format!("plan of {question}").as_bytes()).into()
}

/// The store's answer to the first of these questions that has one which still holds: all results
/// are there. It holds for as long as the store that comes with it, whose lock keeps `gc` out.
pub fn find(questions: &[Digest], store: &Path) -> Result<Option<(Store, UpToDate)>, StoreError> {
    if questions.is_empty() {
        return Ok(None);
    }
    let mut store = Store::open(store)?;
    store.share_if_there();
    Ok(questions
        .iter()
        .find_map(|question| store.no_ops.get(question))
        .map(|up_to_date| (store, up_to_date)))
}

/// What was found to be there.
pub struct Found<'a> {
    /// The pipeline and what of it is asked.
    pub session: &'a Session,
    /// The same, as the planner sees it.
    pub context: &'a Context<'a>,
    /// The results.
    pub store: &'a Store,
    /// When looking began.
    pub since: SystemTime,
}

impl Found<'_> {
    /// Keeps for the next run that this one had nothing to do, if so it was.
    pub fn keep_run(&self, question: &Digest, outcome: &Outcome, view: &View) {
        if outcome.interrupted
            || outcome
                .stages
                .values()
                .any(|stage| stage.end != End::Cached)
        {
            return;
        }
        let shown = |(at, record): (&usize, &Record)| {
            let stage = &self.context.graph.nodes[*at].name;
            evidence::shown(self.store, record, |output| view.output(stage, output))
        };
        // With the list of folders: a run removes those of stages that the pipeline has no more.
        let shown = outcome.records.iter().flat_map(shown).chain([view.list()]);
        self.keep(
            question,
            &outcome
                .records
                .iter()
                .map(|(&at, record)| (at, record))
                .collect(),
            shown.collect(),
        );
    }

    /// Keeps for the next plan that there was nothing to do, if so it was.
    pub fn keep_plan(&self, question: &Digest, forecasts: &BTreeMap<usize, Forecast>) {
        let records = forecasts
            .iter()
            .map(|(&at, forecast)| Some((at, forecast.record()?)));
        if let Some(records) = records.collect() {
            self.keep(&of_plan(question), &records, BTreeSet::new());
        }
    }

    fn keep(
        &self,
        question: &Digest,
        records: &BTreeMap<usize, &Record>,
        mut files: BTreeSet<PathBuf>,
    ) {
        // What a comparison of arms prints is put together from all results: that takes reading the
        // pipeline.
        if self.context.graph.experiment.is_some() {
            return;
        }
        // Where it cannot be said which files a stage reads, nobody can see that they have changed.
        let Some(sources) = self.session.source_files(self.context) else {
            return;
        };
        files.extend(sources);
        files.extend(
            records
                .values()
                .flat_map(|record| evidence::sound(self.store, record)),
        );
        let name = |at: &usize| self.context.graph.nodes[*at].name.clone();
        // Only of these does a run print anything. The others need not be read back.
        let told = records.iter().filter(|(_, record)| results::tells(record));
        let up_to_date = UpToDate {
            pipeline: self.context.graph.pipeline.clone(),
            stages: records
                .iter()
                .map(|(at, record)| (name(at), record.key))
                .collect(),
            told: told
                .map(|(at, record)| (name(at), (*record).clone()))
                .collect(),
        };
        self.store
            .no_ops
            .put(question, up_to_date, files, self.since);
    }
}
