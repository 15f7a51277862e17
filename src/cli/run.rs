//! `run`: computes what the store does not have, and shows the results.

mod ending;
mod room;

use std::collections::BTreeSet;
use std::mem::ManuallyDrop;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant, SystemTime};

use artifacts_schema::Digest;
use clap::Args;
use compute::Device;
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

use super::error::Error;
use super::only::Only;
use super::options::{self, Choice, PipelineOptions};
use super::session::Session;
use super::{device, no_op, tuning};
use crate::export::quote;
use crate::runner::plan::Context;
use crate::runner::scheduler::budget::Budget;
use crate::runner::scheduler::memory_limit::memory_limit;
use crate::runner::scheduler::{Outcome, Scheduler};
use crate::store::Store;
use crate::store::cache::no_op::UpToDate;
use crate::store::error::StoreError;
use crate::store::runs::{End, RunRecord, StageRun, now};
use crate::store::view::View;
use crate::terminal::output::tell;
use crate::terminal::progress::tev::{self, Tev};
use crate::terminal::progress::{self, Event, Verbosity};
use crate::watch::Watched;
use ending::{Ending, verdict};

/// Threads need deep stacks where one stage's work is stolen by another's thread.
const STACK: usize = 16 << 20;

#[derive(Args)]
pub struct Run {
    #[command(flatten)]
    pipeline: PipelineOptions,
    #[command(flatten)]
    choice: Choice,
    #[command(flatten)]
    only: Only,
    /// How many threads compute; by default one per core
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// How much memory stages may take together, by their estimates: 8G, 500M; by default all that
    /// this machine or job has
    #[arg(long, value_name = "SIZE", value_parser = options::size)]
    memory: Option<u64>,
    /// Begin even if a stage is expected to need more memory than this machine or job has
    #[arg(long)]
    over_memory: bool,
    /// How long a stage goes on between two checkpoints: 30s, 5min, 1h, or 0 for one after every
    /// step
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = options::time)]
    checkpoint_every: Duration,
    /// Go on with what does not depend on a stage that has failed (the default)
    #[arg(long, conflicts_with = "fail_fast")]
    keep_going: bool,
    /// Stop as soon as a stage fails
    #[arg(long)]
    fail_fast: bool,
    /// Show tev, the viewer, the images of each stage as it finishes (--tev=HOST:PORT for one that
    /// listens elsewhere)
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, require_equals = true, default_missing_value = tev::USUAL)]
    tev: Option<String>,
    /// Show the run on a page of this machine's loopback, whose address is printed
    #[arg(long)]
    watch: bool,
    /// No bars: one line for each thing that happens
    #[arg(long)]
    no_progress: bool,
    /// Also print keys and digests
    #[arg(short, long)]
    verbose: bool,
    /// Print warnings and errors only
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
}

impl Run {
    /// Runs the pipeline.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let begun = Instant::now();
        let started = now();
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        // Before anything is looked at: what changes from here on must not count as found.
        let since = SystemTime::now();
        let device = device::open(&changes.device)?;
        self.tell_device(&device);
        let question = self
            .only
            .is_all()
            .then(|| no_op::question(&self.pipeline, &self.choice, &device))
            .flatten();
        // Before the pipeline is parsed: with thousands of stages that alone takes most of a run
        // with nothing to do.
        if let Some(found) = no_op::find(question.as_slice(), &changes.folders.store)? {
            return Ok(self.find_all_done(&ManuallyDrop::new(found).1, started, begun, json)?);
        }
        // With thousands of stages it takes long to take all this apart, which the end of the
        // process spares.
        let session = ManuallyDrop::new(Session::on(device, pipeline, changes, &self.choice)?);
        let store = Store::create(&changes.folders.store)?;
        let mut context = session.context(&store);
        let view = View::new(&changes.folders.out, &session.graph.pipeline);
        let only = self.only.stage(&session)?;
        match only {
            // A job of one stage removes no folders: it runs beside the jobs of the others.
            Some(stage) => self.only.narrow(&mut context, stage)?,
            None => view.retain(
                &store,
                session
                    .graph
                    .nodes
                    .iter()
                    .flat_map(|node| node.names().map(str::to_owned))
                    .collect::<BTreeSet<_>>(),
            )?,
        }
        let outcome = ManuallyDrop::new(self.compute(&context, &session, &view, json)?);
        if let Some(stage) = only {
            self.only.stamp(
                &session.graph.nodes[stage].name,
                outcome.records.get(&stage),
            )?;
        }
        let seconds = begun.elapsed().as_secs_f64();
        let record = ManuallyDrop::new(record(&context, &outcome, started, seconds));
        let own = outcome
            .stages
            .iter()
            .filter(|(_, stage)| stage.end == End::Ran);
        // Before `keep`, which writes down what was found.
        store
            .results
            .known
            .remember_own(own.filter_map(|(at, _)| outcome.records.get(at)));
        record.keep(&store)?;
        if let Some(question) = &question {
            no_op::Found {
                session: &session,
                context: &context,
                store: &store,
                since,
            }
            .keep_run(question, &outcome, &view);
        }
        let results = outcome
            .records
            .iter()
            .map(|(&at, result)| (context.graph.nodes[at].name.as_str(), result));
        let name = |at: usize| session.graph.nodes[at].name.as_str();
        let mut ended: Vec<(&str, End)> = outcome
            .stages
            .iter()
            .map(|(&at, stage)| (name(at), stage.end))
            .collect();
        ended.sort_by_key(|(name, _)| *name);
        self.ending(&record, &store, &view, json)
            .tell(&ended, results)?;
        verdict(&outcome, &session.graph)
    }

    /// All results are there, and what was looked at to know it is as it was.
    fn find_all_done(
        &self,
        up_to_date: &UpToDate,
        started: String,
        begun: Instant,
        json: bool,
    ) -> Result<(), StoreError> {
        let UpToDate {
            pipeline,
            stages,
            told,
        } = up_to_date;
        let folders = &self.pipeline.changes.folders;
        let store = Store::create(&folders.store)?;
        let results: Vec<(&str, Digest)> = stages
            .iter()
            .map(|(name, key)| (name.as_str(), *key))
            .collect();
        let mut progress = progress::choose(json, self.verbosity(), !self.no_progress);
        progress.event(&Event::Cached { results: &results });
        for (stage, result) in told {
            for text in &result.remarks {
                progress.event(&Event::Warning { stage, text });
            }
        }
        drop(progress);
        let stages = stages
            .iter()
            .map(|(name, key)| (name.clone(), StageRun::cached(*key)))
            .collect();
        let seconds = begun.elapsed().as_secs_f64();
        let run = ManuallyDrop::new(RunRecord {
            pipeline: pipeline.clone(),
            started,
            seconds,
            stages,
            experiment: None,
            command: Some(command_line()),
        });
        run.keep(&store)?;
        let ended: Vec<(&str, End)> = run
            .stages
            .iter()
            .map(|(name, stage)| (name.as_str(), stage.end))
            .collect();
        let told = told.iter().map(|(name, result)| (name.as_str(), result));
        let view = View::new(&folders.out, pipeline);
        self.ending(&run, &store, &view, json).tell(&ended, told)
    }

    fn compute(
        &self,
        context: &Context,
        session: &Session,
        view: &View,
        json: bool,
    ) -> Result<Outcome, Error> {
        // One pool for all that computes: two of them would want twice as many cores as there are.
        let pool = thread_pool(self.threads)?;
        let cached = pool.install(|| context.cached())?;
        // Now, not when the stage begins: that may be after hours of other stages.
        if !self.over_memory {
            room::check(context, &cached, memory_limit())?;
        }
        // From here on there is something to keep. Before, a signal may end the program at once.
        let cancelled = stop_on_signals()?;
        tuning::apply(&session.device);
        let mut progress = progress::choose(json, self.verbosity(), !self.no_progress);
        if self.watch {
            let names = session.graph.nodes.iter();
            let names = names.flat_map(|node| node.names().map(str::to_owned));
            let run = (context.graph.pipeline.as_str(), names.collect());
            let watched = Watched::beside(progress, run, view, &cancelled).map_err(unwatched)?;
            progress = Box::new(watched);
        }
        if let Some(address) = &self.tev {
            progress = Box::new(Tev::beside(progress, address, view));
        }
        let device = &session.device;
        let checkpoint_every = self.checkpoint_every;
        let budget = self.budget(&pool, device);
        let cancelled = &cancelled;
        let scheduler = Scheduler {
            context,
            pool: &pool,
            device,
            view,
            cancelled,
            checkpoint_every,
            budget,
            fail_fast: self.fail_fast,
        };
        Ok(scheduler.run(cached, progress.as_mut())?)
    }

    /// Says what is computed where, if not all of it is on the CPU.
    fn tell_device(&self, device: &Device) {
        if device.is_gpu() && self.verbosity() > Verbosity::Quiet {
            let kind = device.kind();
            tell(&format_args!(
                "the field (Fit, Sync, Render), the diffusion networks (Encode, Optimize, Decode) and learned filters \
                 (Interpolate) run on the {kind}; all other stages run on the CPU"
            ));
        }
    }

    fn budget(&self, pool: &rayon::ThreadPool, device: &Device) -> Budget {
        let threads = pool.current_num_threads();
        let memory = self.memory.unwrap_or_else(memory_limit);
        Budget {
            threads,
            memory,
            // The memory of a GPU is not counted in estimates, so two stages could fill it.
            one_on_device: device.is_gpu(),
        }
    }

    fn ending<'a>(
        &self,
        run: &'a RunRecord,
        store: &'a Store,
        view: &'a View,
        json: bool,
    ) -> Ending<'a> {
        Ending {
            run,
            store,
            view,
            verbosity: self.verbosity(),
            json,
        }
    }

    fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

/// Says why there is no page.
fn unwatched(error: std::io::Error) -> Error {
    let message = format!("cannot serve on 127.0.0.1: {error}");
    Error::usage(
        message,
        "the same command without --watch runs all the same",
    )
}

/// What became of each stage, under each of its names.
fn record(context: &Context, outcome: &Outcome, started: String, seconds: f64) -> RunRecord {
    let names = |at: usize| context.graph.nodes[at].names();
    let stages = outcome
        .stages
        .iter()
        .flat_map(|(&at, stage)| names(at).map(|name| (name.to_owned(), stage.clone())))
        .collect();
    RunRecord {
        pipeline: context.graph.pipeline.clone(),
        started,
        seconds,
        stages,
        experiment: context.graph.experiment.clone(),
        command: Some(command_line()),
    }
}

/// The words that this process was started with, as a shell would read them.
fn command_line() -> String {
    let words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    quote::command(&words.collect::<Vec<_>>())
}

/// The threads that stages share; as many as there are cores where `threads` is 0.
pub(super) fn thread_pool(threads: usize) -> Result<rayon::ThreadPool, Error> {
    let builder = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK);
    builder
        .build()
        .map_err(|error| Error::usage(error.to_string(), "try fewer --threads"))
}

/// The first signal asks for checkpoints and a stop; the second one stops at once, as if nothing
/// caught it. SIGUSR1 is what Slurm sends ahead of the end of a job's time.
pub(super) fn stop_on_signals() -> Result<Arc<AtomicBool>, Error> {
    catch_signals().map_err(|error| Error::usage(format!("no signals: {error}"), "try again"))
}

fn catch_signals() -> std::io::Result<Arc<AtomicBool>> {
    let cancelled = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGUSR1] {
        // The order matters: handlers run as they were registered. The first signal finds the flag
        // unset here, and sets it below; the second one finds it set.
        // The code is the one that shells report of a process that the signal ended.
        signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, cancelled.clone())?;
        signal_hook::flag::register(signal, cancelled.clone())?;
    }
    Ok(cancelled)
}
