//! `completions` and `man`: what shells and `man` know of the command line, made from the command
//! line itself.

use std::fs;
use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;

use super::error::Error;
use crate::terminal::output::print;

#[derive(Args)]
pub struct Completions {
    /// The shell
    shell: Shell,
}

impl Completions {
    /// Prints a script for the shell.
    pub fn run(self, mut command: Command) {
        let name = command.get_name().to_owned();
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut command, name, &mut script);
        let script = String::from_utf8_lossy(&script);
        // For bash, clap_complete 4.6 writes a name with a hyphen in two ways that do not meet, so
        // that options of commands are not found (github.com/clap-rs/clap/issues/6421).
        let script = script.replace("srnerf__subcmd__dag", "srnerf__dag");
        print(&script.trim_end());
    }
}

#[derive(Args)]
pub struct Man {
    /// The folder to write to; it is made if it is not there
    #[arg(short, long, value_name = "FOLDER", default_value = "man")]
    output: PathBuf,
}

impl Man {
    /// Writes one page for the program and one for each command.
    pub fn run(self, command: Command) -> Result<(), Error> {
        let folder = self.output.display();
        let made = fs::create_dir_all(&self.output);
        let written = made.and_then(|()| clap_mangen::generate_to(command, &self.output));
        written.map_err(|error| {
            Error::usage(
                format!("cannot write to {folder}: {error}"),
                "give another folder: --output FOLDER",
            )
        })?;
        print(&format_args!(
            "wrote {folder}; man -l {folder}/srnerf-dag.1 shows the first page"
        ));
        Ok(())
    }
}
