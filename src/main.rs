//! The command `srnerf-dag`: reads the command line, does it, and turns what went wrong into one
//! message and an exit code.

mod cli;
mod content;
mod export;
mod import;
mod kinds;
mod loopback;
mod pipeline;
mod remote;
mod report;
mod runner;
mod store;
mod terminal;
mod view;
mod watch;

use std::process::ExitCode;

use clap::Parser;

use runner::task;
use terminal::{exit, output};

fn main() -> ExitCode {
    task::quiet_panics();
    // Panics of stages are caught where they run. One that gets here is a bug of the program around
    // them.
    match std::panic::catch_unwind(|| cli::Cli::parse().run()) {
        Ok(code) => ExitCode::from(code),
        Err(panic) => {
            let text = task::panic_text(&*panic);
            output::tell(&format_args!(
                "internal error: {text}; this is a bug in srnerf-dag, please report it"
            ));
            ExitCode::from(exit::BUG)
        }
    }
}
