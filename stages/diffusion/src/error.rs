//! Why a model could not be used: names the file, and the tensor or field in it.
//!
//! Knows nothing of pipelines; paths are as the caller gave them.

/// Why a model could not be loaded or does not fit what is asked of it.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file or folder that is missing or cannot be read.
    #[error("{file}: {problem}")]
    File {
        /// The file.
        file: String,
        /// What is wrong with it, and how to mend it.
        problem: String,
    },
    /// A field of a configuration that is missing, malformed or not supported.
    #[error("{file}: `{field}` {problem}")]
    Field {
        /// The configuration file.
        file: String,
        /// The field, as a path from the file's root.
        field: String,
        /// What is wrong: "is \"swish\"; supported is \"silu\"".
        problem: String,
    },
    /// A tensor that is missing, of another shape or of another type than the configuration asks
    /// for.
    #[error("{file}: tensor `{tensor}` {problem}")]
    Tensor {
        /// The weight file.
        file: String,
        /// The tensor's name in the file.
        tensor: String,
        /// What is wrong: "has the shape [4, 3]; the configuration asks for [4, 4]".
        problem: String,
    },
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
        Self::Tensor {
            file: file.to_owned(),
            tensor: tensor.to_owned(),
            problem: problem.into(),
        }
    }
}
