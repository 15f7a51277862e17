//! Everything that can go wrong with a command, and the exit code that it gives.

use std::path::PathBuf;

use miette::Diagnostic;

use crate::import::ImportError;
use crate::pipeline::graph::{UnknownArm, UnknownStage};
use crate::pipeline::problem::Problem;
use crate::remote::{AddressError, RemoteFault};
use crate::runner::plan::SourceError;
use crate::store::error::StoreError;
use crate::terminal::exit::{BUG, FAILED, FOUND, INTERRUPTED, PIPELINE, STORE, USAGE};

/// What went wrong with a command.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum Error {
    /// The pipeline, or an override of it.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Pipeline(#[from] Problem),
    /// The pipeline file cannot be read.
    #[error("cannot read the pipeline {}: {error}", .path.display())]
    #[diagnostic(help("give the path of a pipeline file, such as pipelines/i3ds.ron"))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// Something that the pipeline names.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// Photos that a command looks at.
    #[error(transparent)]
    #[diagnostic(help("docs/inputs.md says what is read of each layout"))]
    Photos(#[from] scene::SceneError),
    /// Poses for photos that have none.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Import(#[from] ImportError),
    /// A diffusion model, or a file of tensors for it.
    #[error(transparent)]
    Model(#[from] diffusion::ModelError),
    /// Results that no file of tensors can hold.
    #[error(transparent)]
    Tensors(#[from] formats::tensor_file::WriteError),
    #[error(transparent)]
    Upsampler(#[from] upsampler::UpsamplerError),
    /// A stage that there is not.
    #[error(transparent)]
    UnknownStage(#[from] UnknownStage),
    /// An arm that there is not.
    #[error(transparent)]
    UnknownArm(#[from] UnknownArm),
    /// A stage that cannot run alone.
    #[error(
        "`{stage}` cannot run alone yet: what it reads, `{missing}`, has no result in the store"
    )]
    #[diagnostic(help(
        "run that first, with the same --set, --salt and --store, or leave --only out"
    ))]
    NoInput {
        stage: String,
        /// The first stage before it that has no result.
        missing: String,
    },
    /// A stage that is too large for this machine.
    #[error(
        "`{stage}` is expected to need {needed} of memory ({why}), and this machine or job has {there}; nothing was run"
    )]
    #[diagnostic(help(
        "run it where there is more, make it smaller (smaller images, a smaller model, fewer `samples`, a smaller `batch`, more `shards`), \
         or run it all the same: --over-memory"
    ))]
    NoRoom {
        stage: String,
        needed: String,
        /// How that is known.
        why: String,
        there: String,
    },
    #[error(transparent)]
    #[diagnostic(transparent)]
    Store(#[from] StoreError),
    /// The address of a remote.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Address(#[from] AddressError),
    /// A remote that a command is about.
    #[error("{address}: {fault}")]
    Remote {
        /// Where it is.
        address: String,
        /// What is wrong.
        fault: RemoteFault,
    },
    /// The command line, in a way that its parser does not see.
    #[error("{message}")]
    Usage {
        /// What makes no sense.
        message: String,
        /// How to mend it.
        #[help]
        help: Option<String>,
    },
    /// Stages failed, and said so when they did.
    #[error("{0}")]
    Failed(String),
    /// A stage's result could not be kept, as was said when it happened.
    #[error("{0}")]
    FailedStore(String),
    /// A stage has a bug, as was said when it happened.
    #[error("{0}")]
    Bug(String),
    /// A check found something, and has said what.
    #[error("{message}")]
    Found {
        /// How much.
        message: String,
        /// What it means, or how to mend it.
        #[help]
        help: Option<String>,
    },
    /// Standard output lacks lines. What the command did beside printing them is done.
    #[error("standard output is not complete: {0}")]
    Output(&'static std::io::Error),
    /// The run was interrupted.
    #[error("interrupted; the same command goes on where this one stopped")]
    Interrupted,
}

impl Error {
    /// A command line that makes no sense.
    pub fn usage(message: impl Into<String>, help: impl Into<String>) -> Self {
        Self::Usage {
            message: message.into(),
            help: Some(help.into()),
        }
    }

    /// Whether a run came to its end with this: its last event tells what happened to each stage.
    pub fn is_of_a_whole_run(&self) -> bool {
        matches!(
            self,
            Self::Failed(_) | Self::FailedStore(_) | Self::Bug(_) | Self::Interrupted
        )
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        match self {
            Self::Failed(_) => FAILED,
            Self::Import(error) => error.exit_code(),
            Self::Usage { .. } | Self::UnknownStage(_) | Self::UnknownArm(_) | Self::Address(_) => {
                USAGE
            }
            Self::Pipeline(problem) if problem.is_in_argument() => USAGE,
            Self::Pipeline(_)
            | Self::Unreadable { .. }
            | Self::Source(_)
            | Self::Photos(_)
            | Self::Model(_)
            | Self::Tensors(_)
            | Self::Upsampler(_) => PIPELINE,
            // Nothing was run, which is what this code says.
            Self::NoInput { .. } | Self::NoRoom { .. } => PIPELINE,
            Self::Store(_) | Self::FailedStore(_) | Self::Remote { .. } | Self::Output(_) => STORE,
            Self::Found { .. } => FOUND,
            Self::Interrupted => INTERRUPTED,
            Self::Bug(_) => BUG,
        }
    }
}
