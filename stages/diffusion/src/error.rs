//! Why a model could not be used: names the file, and the tensor or field in it.
//!
//! Knows nothing of pipelines; paths are as the caller gave them.

use formats::{FileError, TensorError};

use crate::single_file::error::SingleFileError;

/// Why a model could not be loaded or does not fit what is asked of it.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file or folder that cannot be used.
    #[error("{file}: {problem}")]
    File {
        /// The file or folder, as it was named.
        file: String,
        /// What is wrong with it, and how to mend it.
        problem: String,
    },
    /// A field of a configuration that is missing, malformed or not supported.
    #[error("{file}: `{field}` {problem}")]
    Field {
        /// The configuration file, as it was named.
        file: String,
        /// The field, as a path from the file's root.
        field: String,
        /// What is wrong: "is \"swish\"; supported is \"silu\"".
        problem: String,
    },
    /// A file that is not there, or cannot be read.
    #[error(transparent)]
    Unread(#[from] FileError),
    /// A tensor that is missing, of another shape or of another type than the configuration asks
    /// for.
    #[error(transparent)]
    Tensor(#[from] TensorError),
    /// A single file that is not the x4 upscaler, or not all of it.
    #[error(transparent)]
    SingleFile(#[from] SingleFileError),
}

impl ModelError {
    /// A file that cannot be used, and why.
    pub(crate) fn file(file: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::File {
            file: file.into(),
            problem: problem.into(),
        }
    }

    /// A configuration field that cannot be used, and why.
    pub(crate) fn field(file: &str, field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Field {
            file: file.to_owned(),
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// A tensor that cannot be used, and why.
    pub(crate) fn tensor(file: &str, tensor: &str, problem: impl Into<String>) -> Self {
        TensorError::tensor(file, tensor, problem.into()).into()
    }
}
