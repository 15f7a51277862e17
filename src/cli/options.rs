//! Options that several subcommands share.

use std::path::PathBuf;

use clap::Args;

/// Which pipeline, and with which changes.
#[derive(Args)]
pub struct PipelineOptions {
    /// The pipeline file
    #[arg(default_value = "pipelines/i3ds.ron")]
    pub pipeline: PathBuf,
    #[command(flatten)]
    pub changes: Changes,
}

/// Changes to a pipeline, and where its results lie.
#[derive(Args)]
pub struct Changes {
    /// Override one value, in RON: --set scene.downscale=2 (repeatable)
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<String>,
    /// A word in all keys: it sets a whole set of results apart
    #[arg(long)]
    pub salt: Option<String>,
    /// Where to compute: auto, cpu, gpu or gpu:N
    #[arg(long, default_value = "auto")]
    pub device: String,
    #[command(flatten)]
    pub folders: Folders,
}

/// Where results lie.
#[derive(Args, Clone)]
pub struct Folders {
    /// The folder of the store
    #[arg(long, default_value = ".srnerf", value_name = "FOLDER")]
    pub store: PathBuf,
    /// The folder in which to show results
    #[arg(long, default_value = "out", value_name = "FOLDER")]
    pub out: PathBuf,
}

/// Which stages of a pipeline.
#[derive(Args, Default)]
pub struct Choice {
    /// Only this stage and what it needs: i3ds.2.decode, i3ds.decode (all rounds) or i3ds (repeatable)
    #[arg(long, value_name = "STAGE")]
    pub target: Vec<String>,
    /// Compute this stage even if its result is there (repeatable)
    #[arg(long, value_name = "STAGE")]
    pub force: Vec<String>,
}
