//! Why a stage failed, in words for the person who wrote the pipeline.

use std::path::PathBuf;

use artifacts_schema::SchemaError;

/// Why a stage failed.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// A parameter that makes no sense.
    #[error("`{field}` {problem}")]
    Parameter {
        /// The field, as a path from the stage: `guidance.lora_every`.
        field: &'static str,
        /// What is wrong and what would be right: "is 0; it must be at least 1".
        problem: String,
    },
    /// An input that nobody connected.
    #[error("input `{0}` is not connected")]
    MissingInput(String),
    /// Inputs that do not fit together.
    #[error("{0}")]
    Mismatch(String),
    /// A file that could not be used.
    #[error("{path}: {problem}")]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it, and how to mend it.
        problem: String,
    },
    /// An artifact that could not be read or written.
    #[error(transparent)]
    Artifact(#[from] SchemaError),
    /// A scene that could not be read.
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    /// A model that could not be loaded.
    #[error(transparent)]
    Model(#[from] diffusion::ModelError),
    /// An upsampler that could not be loaded.
    #[error(transparent)]
    Upsampler(#[from] upsampler::UpsamplerError),
    /// Weights of a metric that could not be loaded.
    #[error(transparent)]
    Lpips(#[from] metrics::LpipsError),
    /// A device that failed while the stage computed on it.
    #[error(transparent)]
    Device(#[from] compute::GpuError),
    /// Numbers that have grown beyond all bounds. The last checkpoint is from before.
    #[error("the loss is not a number any more after step {step}; a lower `{rate}` should mend it")]
    Diverged {
        /// The step, from 1.
        step: u64,
        /// The parameter that is likely too high.
        rate: &'static str,
    },
    /// The run is being stopped; nothing is wrong.
    #[error("stopped")]
    Cancelled,
}

impl StageError {
    /// A parameter that makes no sense: the field and what is wrong with it.
    pub fn parameter(field: &'static str, problem: impl Into<String>) -> Self {
        Self::Parameter {
            field,
            problem: problem.into(),
        }
    }
}
