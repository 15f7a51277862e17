//! The command line: one file per subcommand. Knows how to print, and leaves deciding to others.

mod artifact;
mod completions;
mod device;
mod diff;
mod doctor;
pub mod error;
mod explain;
mod export;
mod export_cameras;
mod export_exr;
mod export_kohya;
mod export_latents;
mod export_layout;
mod export_ply;
mod export_splat;
mod export_tensorboard;
mod export_transforms;
mod export_video;
mod gc;
mod import;
mod init;
mod inspect;
mod kinds;
mod metrics;
mod model;
mod model_check;
mod model_pull;
mod model_run;
mod named;
mod no_op;
mod numbered;
mod only;
mod options;
mod pin;
mod plan;
mod report;
mod run;
mod session;
mod store;
mod takes;
mod tuning;
mod upsample;
mod verify;
mod view;
mod whence;
mod whole;

use clap::{CommandFactory, Parser, Subcommand};

use self::error::Error;
use crate::terminal::exit;
use crate::terminal::output::{complete, print, tell};

/// Super-resolves radiance fields: a pipeline of cached, resumable stages.
#[derive(Parser)]
#[command(version, about, after_help = exit::HELP)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print JSON on standard output
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Find where photos were taken, with COLMAP, and write a pipeline for them
    Import(import::Import),
    /// Look at a folder of posed photos, and write a pipeline for them
    Init(init::Init),
    /// Run a pipeline: compute what the store does not have
    Run(run::Run),
    /// Say what `run` would do, and why
    Plan(plan::Plan),
    /// Print what decides a stage's result, and what is different from before
    Explain(explain::Explain),
    /// Say what is in a file, or in a stage's outputs
    Inspect(inspect::Inspect),
    /// Print the reference of stage kinds: inputs, outputs, parameters, defaults, ranges
    Kinds(kinds::Kinds),
    /// Print the metrics of the last run
    Metrics(metrics::Metrics),
    /// Write the comparison of the last run's arms as one HTML file
    Report(report::Report),
    /// Look at a field in a browser on this machine, beside another one and its photos
    View(view::View),
    /// Write a pipeline down as jobs for Snakemake or Slurm, or results for other programs
    #[command(subcommand)]
    Export(export::Export),
    /// Compare two runs, two results or two pipelines, and name what differs by itself
    Diff(diff::Diff),
    /// Compute stages once more, in a private place, and compare
    Verify(verify::Verify),
    /// Say which stage made a file, with what
    Whence(whence::Whence),
    /// Say which results nobody needs any more, and remove them with --delete
    Gc(gc::Gc),
    /// Keep the results of a run whatever `gc` does; without a name, list all pins
    Pin(pin::Pin),
    /// Let `gc` decide again
    Unpin(pin::Unpin),
    /// Look after the store
    #[command(subcommand)]
    Store(store::Store),
    /// Get or check a diffusion model, or ask one of its networks
    Model(model::Model),
    /// Print what a shell has to know to complete commands and options
    Completions(completions::Completions),
    /// Write manual pages
    Man(completions::Man),
    /// Say which GPUs there are, which one would be used, and whether it computes right
    Doctor(doctor::Doctor),
}

impl Cli {
    /// Does what was asked, and says what went wrong.
    pub fn run(self) -> u8 {
        let done = match self.command {
            Command::Import(import) => import.run(self.json),
            Command::Init(init) => init.run(self.json),
            Command::Run(run) => run.run(self.json),
            Command::Plan(plan) => plan.run(self.json),
            Command::Explain(explain) => explain.run(self.json),
            Command::Inspect(inspect) => inspect.run(self.json),
            Command::Kinds(kinds) => kinds.run(self.json),
            Command::Metrics(metrics) => metrics.run(self.json),
            Command::Report(report) => report.run(),
            Command::View(view) => view.run(self.json),
            Command::Export(export) => export.run(self.json),
            Command::Diff(diff) => diff.run(self.json),
            Command::Verify(verify) => verify.run(self.json),
            Command::Whence(whence) => whence.run(self.json),
            Command::Gc(gc) => gc.run(self.json),
            Command::Pin(pin) => pin.run(self.json),
            Command::Unpin(unpin) => unpin.run(),
            Command::Store(store) => store.run(self.json),
            Command::Model(model) => model.run(self.json),
            Command::Completions(completions) => {
                completions.run(Self::command());
                Ok(())
            }
            Command::Man(man) => man.run(Self::command()),
            Command::Doctor(doctor) => doctor.run(self.json),
        };
        // A command that failed by itself says so first: that its output is cut short matters less.
        match done.and_then(|()| complete().map_err(Error::Output)) {
            Ok(()) => exit::OK,
            Err(error) => {
                let code = error.code();
                report(error, self.json);
                code
            }
        }
    }
}

/// Says what went wrong: on stderr for people, and with `--json` on stdout, unless the events of a
/// run have said it already.
fn report(error: Error, json: bool) {
    if json && !error.is_of_a_whole_run() {
        // Apart from the message, so that programs need not take it to pieces.
        let (place, help) = match &error {
            Error::Pipeline(problem) => {
                (Some(problem.place()), problem.advice().map(str::to_owned))
            }
            _ => (None, None),
        };
        let message = error.to_string();
        // On one line: those who read the events of a run read line by line.
        print(
            &serde_json::json!({"event": "error", "message": message, "place": place, "help": help, "code": error.code()}),
        );
    }
    tell(&format_args!("{:?}", miette::Report::new(error)));
}
