//! `verify`: computes stages once more, in a private place, and compares with what the store has.
//! Leaves the store alone.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use artifacts_schema::{Provenance, semantic_digest};
use clap::Args;
use compute::device::attempt;
use serde_json::{Value, json};
use stages::{Io, Message, StageError};

use super::error::Error;
use super::options::{Changes, Choice};
use super::run::{stop_on_signals, thread_pool};
use super::session::Session;
use super::tuning;
use crate::content::compare::{self, Comparison};
use crate::runner::plan::{self, Context, Forecast};
use crate::runner::task::{device_of, panic_text};
use crate::store::Store;
use crate::store::error::{At, StoreError};
use crate::store::record::{Output, Record};
use crate::terminal::output::{print, print_json, table};
use crate::terminal::progress::{self, Event, Verbosity};

#[derive(Args)]
pub struct Verify {
    /// A stage (fit, i3ds.2.decode, i3ds.decode for all rounds); by default all that have results
    stage: Option<String>,
    /// The pipeline file
    #[arg(default_value = "pipelines/i3ds.ron")]
    pipeline: PathBuf,
    #[command(flatten)]
    changes: Changes,
    /// How many threads compute; by default one per core
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    threads: usize,
}

/// What came of computing a stage again.
struct Verdict {
    stage: String,
    /// The files that differ, of outputs whose content does. None at all: the same bits.
    differences: Vec<(String, Comparison)>,
    /// Whether there was no result to compare with.
    absent: bool,
}

impl Verify {
    /// Computes and compares.
    pub fn run(mut self, json: bool) -> Result<(), Error> {
        // `verify other.ron` is about a pipeline, not about a stage.
        if let Some(pipeline) = self.stage.take_if(|word| word.ends_with(".ron")) {
            self.pipeline = pipeline.into();
        }
        let choice = Choice {
            target: self.stage.iter().cloned().collect(),
            ..Choice::default()
        };
        let session = Session::new(&self.pipeline, &self.changes, &choice)?;
        let store = Store::open(&self.changes.folders.store)?;
        // What was begun on one device and ended on another, nobody can compute again.
        let context = Context {
            fallback: None,
            ..session.context(&store)
        };
        let wanted = match &self.stage {
            Some(name) => session.graph.find(name)?,
            None => context.needed.clone(),
        };
        let verdicts = self.verify(&session, &context, &wanted, json)?;
        if json {
            print_json(&json!({"stages": verdicts.iter().map(Verdict::json).collect::<Vec<_>>()}));
        } else {
            print(&table(
                &verdicts.iter().flat_map(Verdict::rows).collect::<Vec<_>>(),
                false,
            ));
        }
        conclude(&verdicts, self.stage.is_some())
    }

    fn verify(
        &self,
        session: &Session,
        context: &Context,
        wanted: &BTreeSet<usize>,
        json: bool,
    ) -> Result<Vec<Verdict>, Error> {
        let pool = thread_pool(self.threads)?;
        let cancelled = stop_on_signals()?;
        tuning::apply(&session.device);
        let quiet = if json {
            Verbosity::Quiet
        } else {
            Verbosity::Normal
        };
        let progress = Mutex::new(progress::choose(false, quiet, true));
        let tell = |event: &Event| {
            if let Ok(mut progress) = progress.lock() {
                progress.event(event);
            }
        };
        let forecasts = pool.install(|| context.forecast())?;
        let mut verdicts = Vec::new();
        for &at in wanted {
            let stage = &context.graph.nodes[at].name;
            let Some(Forecast::Cached(assessment)) = forecasts.get(&at) else {
                verdicts.push(Verdict {
                    stage: stage.clone(),
                    differences: Vec::new(),
                    absent: true,
                });
                continue;
            };
            let Ok(record) = &assessment.verdict else {
                continue;
            };
            let begun = Instant::now();
            tell(&Event::Started {
                stage,
                key: assessment.key,
                reason: "computing it again",
            });
            // Outside of the store, which then has no lease, no work folder and no result of this.
            let folder = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
            let inputs = inputs(context, at, &forecasts, folder.path())?;
            let say = |message: Message| {
                tell(&Event::Said {
                    stage,
                    message: &message,
                })
            };
            let io = Io {
                seed: context.graph.nodes[at].seed,
                device: device_of(&*context.graph.nodes[at].stage, &session.device),
                inputs,
                outputs: folder.path().join("out"),
                scratch: folder.path().join("scratch"),
                // Nobody goes on from this, and an earlier state would verify nothing.
                checkpoint_every: Duration::MAX,
                earlier: None,
                // What is compared is content, which says nothing of provenance.
                provenance: Provenance::default(),
                messages: &say,
                cancelled: &|| cancelled.load(Ordering::Relaxed),
            };
            std::fs::create_dir_all(&io.scratch).at("create", &io.scratch)?;
            pool.install(|| compute(context, at, &io))?;
            let differences = differences(context.store, record, &io.outputs)?;
            tell(&Event::Finished {
                stage,
                seconds: begun.elapsed().as_secs_f64(),
                record,
            });
            verdicts.push(Verdict {
                stage: stage.clone(),
                differences,
                absent: false,
            });
        }
        Ok(verdicts)
    }
}

fn compute(context: &Context, at: usize, io: &Io) -> Result<(), Error> {
    let node = &context.graph.nodes[at];
    // A panic is the stage's bug, and is told with its name.
    match catch_unwind(AssertUnwindSafe(|| {
        attempt(|| node.stage.run(io)).unwrap_or_else(|fault| Err(fault.into()))
    })) {
        Ok(Ok(())) => Ok(()),
        Ok(Err(StageError::Cancelled)) => Err(Error::Interrupted),
        Ok(Err(error)) => Err(Error::Failed(format!("{}: {error}", node.name))),
        Err(panic) => Err(Error::Bug(format!(
            "{}: internal error: {}",
            node.name,
            panic_text(&*panic)
        ))),
    }
}

/// Shows a stage's inputs in a private folder.
fn inputs(
    context: &Context,
    at: usize,
    forecasts: &BTreeMap<usize, Forecast>,
    folder: &Path,
) -> Result<BTreeMap<String, PathBuf>, StoreError> {
    let result = |from: usize| forecasts.get(&from)?.record();
    let outputs = plan::inputs::read(&context.graph.nodes[at], result).into_iter();
    let show = |(input, output): (&str, &Output)| {
        let folder = folder.join("in").join(input);
        output.show(context.store, &folder)?;
        Ok((input.to_owned(), folder))
    };
    outputs.map(show).collect()
}

/// The files that differ between a result and what was computed now.
fn differences(
    store: &Store,
    record: &Record,
    folder: &Path,
) -> Result<Vec<(String, Comparison)>, StoreError> {
    let mut differences = Vec::new();
    for (name, output) in &record.outputs {
        let folder = folder.join(name);
        // By content first: the files themselves also say which stage made them.
        let same =
            semantic_digest(output.kind, &folder).is_ok_and(|digest| digest == output.digest);
        if !same {
            let files = differing_files(store, name, output, &folder)?;
            // An output can differ where its numbers do not: in a text, or in which files there
            // are.
            let unlike = files.is_empty().then(|| (name.clone(), Comparison::Unlike));
            differences.extend(files.into_iter().chain(unlike));
        }
    }
    Ok(differences)
}

fn differing_files(
    store: &Store,
    name: &str,
    output: &Output,
    folder: &Path,
) -> Result<Vec<(String, Comparison)>, StoreError> {
    let stored = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
    output.show(store, stored.path())?;
    let compare = |path: &String| compare::files(&stored.path().join(path), &folder.join(path));
    let files = output
        .files
        .iter()
        .map(|file| (format!("{name}/{}", file.path), compare(&file.path)));
    Ok(files
        .filter(|(_, comparison)| *comparison != Comparison::Arrays(Vec::new()))
        .collect())
}

impl Verdict {
    fn state(&self) -> &'static str {
        match (self.absent, self.differences.is_empty()) {
            (true, _) => "no result",
            (_, true) => "the same bits",
            _ => "differs",
        }
    }

    fn rows(&self) -> Vec<Vec<String>> {
        let head = vec![self.stage.clone(), self.state().to_owned()];
        let files = self
            .differences
            .iter()
            .flat_map(|(file, comparison)| match comparison {
                Comparison::Unlike => {
                    vec![vec![format!("  {file}"), "holds something else".to_owned()]]
                }
                Comparison::Arrays(arrays) => arrays
                    .iter()
                    .map(|(name, d)| {
                        let text = format!(
                            "{} of {} values, at most {} ulp, {:.1} dB",
                            d.differ, d.values, d.ulps, d.psnr
                        );
                        vec![format!("  {file} {name}"), text]
                    })
                    .collect(),
            });
        std::iter::once(head).chain(files).collect()
    }

    fn json(&self) -> Value {
        let files: BTreeMap<_, _> = self
            .differences
            .iter()
            .map(|(file, comparison)| (file, comparison))
            .collect();
        json!({"stage": self.stage, "state": self.state().replace(' ', "_"), "differences": files})
    }
}

fn conclude(verdicts: &[Verdict], named: bool) -> Result<(), Error> {
    let differ = verdicts
        .iter()
        .filter(|verdict| !verdict.differences.is_empty())
        .count();
    let absent = verdicts.iter().filter(|verdict| verdict.absent).count();
    if differ > 0 {
        let message = format!(
            "{differ} of {} stages did not come to the same result again",
            verdicts.len()
        );
        return Err(Error::Found {
            message,
            help: None,
        });
    }
    // Of a whole pipeline some stages may not have run yet. A stage that was named must have.
    if absent == verdicts.len() || (named && absent > 0) {
        let help = "run it first, with the same --set, --salt and --store";
        return Err(Error::usage(
            format!("{absent} stages have no result to compare with"),
            help,
        ));
    }
    Ok(())
}
