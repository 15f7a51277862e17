//! `model`: checks a model, gets one, or asks one of its networks. Writes nothing but the file or
//! folder it is given.

use clap::{Args, Subcommand};

use super::error::Error;
use super::{model_check, model_pull, model_run};

#[derive(Args)]
pub struct Model {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Read a model whole: its configurations, tensors, sizes, the memory it needs, and its files'
    /// digests
    Check(model_check::Check),
    /// Get a model from the Hugging Face hub
    Pull(model_pull::Pull),
    /// Ask one network about the tensors of a file
    Run(model_run::Run),
}

impl Model {
    /// Does what was asked.
    pub fn run(self, json: bool) -> Result<(), Error> {
        match self.command {
            Command::Check(check) => check.run(json),
            Command::Pull(pull) => pull.run(json),
            Command::Run(run) => run.run(json),
        }
    }
}
