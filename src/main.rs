//! The command `srnerf-dag`: reads the command line, does it, and turns what went wrong into one
//! message and an exit code.

mod cli;
mod compare;
mod comparison;
mod content;
mod diff;
mod error;
mod experiment;
mod explain;
mod export;
mod extension;
mod import;
mod init;
mod key;
mod kinds;
mod lineage;
mod loopback;
mod page;
mod peak;
mod pipeline;
mod plan;
mod progress;
mod remote;
mod report;
mod scheduler;
mod store;
mod task;
#[cfg(test)]
mod testing;
mod view;
mod watch;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    task::quiet_panics();
    // Panics of stages are caught where they run. One that gets here is a bug of the program around
    // them.
    match std::panic::catch_unwind(|| cli::Cli::parse().run()) {
        Ok(code) => ExitCode::from(code),
        Err(panic) => {
            let text = task::panic_text(&*panic);
            cli::tell(&format_args!(
                "internal error: {text}; this is a bug in srnerf-dag, please report it"
            ));
            ExitCode::from(error::BUG)
        }
    }
}
