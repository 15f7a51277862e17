//! Why an upsampler could not be used: names the file, and the tensor or layer in it.
//!
//! Knows nothing of pipelines; paths are as the caller gave them.

use formats::{FileError, TensorError};

/// Why a file is no upsampler that can be used here.
#[derive(Debug, thiserror::Error)]
pub enum UpsamplerError {
    /// A file that is something else than is wanted.
    #[error("{file}: {problem}")]
    File {
        /// The path of the file.
        file: String,
        /// What is wrong with it, and how to mend it.
        problem: String,
    },
    /// A file that is not there, or cannot be read.
    #[error(transparent)]
    Unread(#[from] FileError),
    /// A tensor that is missing, of another shape or type, or of no network that is known here.
    #[error(transparent)]
    Tensor(#[from] TensorError),
    /// A layer of an ncnn graph that cannot be used.
    #[error("{file}: line {line}: layer {layer} {problem}")]
    Layer {
        /// The path of the `.param` file.
        file: String,
        /// The line in it, from 1.
        line: usize,
        /// The layer's name and kind: "`conv_1` (Convolution)".
        layer: String,
        /// What is wrong: "is of a kind that is not known here".
        problem: String,
    },
}

impl UpsamplerError {
    pub(crate) fn file(file: &str, problem: impl Into<String>) -> Self {
        Self::File {
            file: file.to_owned(),
            problem: problem.into(),
        }
    }
}
