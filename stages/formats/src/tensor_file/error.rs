//! Why a safetensors file cannot be used, in words that name it and the tensor in it.

use safetensors::SafeTensorError;

/// Why a safetensors file, or a tensor of it, cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TensorError {
    /// A header that is none, or does not fit the file.
    #[error("{file}: is not a sound safetensors file: {source}")]
    Header {
        /// The path of the file.
        file: String,
        /// What its reader said.
        source: SafeTensorError,
    },
    /// A tensor that is missing, of another shape or of another type than is asked for.
    #[error("{file}: tensor `{tensor}` {problem}")]
    Tensor {
        /// The path of the file.
        file: String,
        /// The tensor's name in the file.
        tensor: String,
        /// What is wrong: "has the shape [4, 3]; the configuration asks for [4, 4]".
        problem: String,
    },
}

impl TensorError {
    /// A tensor that cannot be used, and why.
    pub fn tensor(
        file: impl Into<String>,
        tensor: impl Into<String>,
        problem: impl ToString,
    ) -> Self {
        Self::Tensor {
            file: file.into(),
            tensor: tensor.into(),
            problem: problem.to_string(),
        }
    }
}
