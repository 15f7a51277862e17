//! Why an artifact could not be read or written, in words that name the file and the place in it.

use std::path::{Path, PathBuf};

/// Why an artifact could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SchemaError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the file system said.
        source: std::io::Error,
    },
    /// A file whose content is not what its name promises.
    #[error("{}: {place}: {problem}", path.display())]
    Malformed {
        /// The path of the file.
        path: PathBuf,
        /// Where in the file: a tensor, a channel, a line.
        place: String,
        /// What is there, and what was expected.
        problem: String,
    },
    /// Content that has no form on disk; nothing was written.
    #[error("{place}: {problem}")]
    Content {
        /// Where in the content: a view, a tensor, a metric.
        place: String,
        /// What is there, and what was expected.
        problem: String,
    },
}

impl SchemaError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    pub(crate) fn malformed(path: &Path, place: impl Into<String>, problem: impl ToString) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            place: place.into(),
            problem: problem.to_string(),
        }
    }

    pub(crate) fn content(place: impl Into<String>, problem: impl ToString) -> Self {
        Self::Content {
            place: place.into(),
            problem: problem.to_string(),
        }
    }

    /// Turns a problem of content into one of the file that the content came from.
    pub(crate) fn in_file(self, file: &Path) -> Self {
        // Checks do not know where content came from; only readers can name the file.
        match self {
            Self::Content { place, problem } => Self::Malformed {
                path: file.to_owned(),
                place,
                problem,
            },
            other => other,
        }
    }
}
