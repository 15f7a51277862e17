//! Why the store could not be used: what was tried, on which file, and how to mend it.

use std::io;
use std::path::{Path, PathBuf};

/// Why the store could not be used.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum StoreError {
    /// The file system refused something.
    #[error("cannot {action} {}: {error}", .path.display())]
    Io {
        /// What was tried: a verb.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
        /// How to mend it.
        #[help]
        help: Option<&'static str>,
    },
    /// A store of another layout.
    #[error("{} is a store of layout {found}; this program knows layout {}", .root.display(), super::files::VERSION)]
    #[diagnostic(help("use another folder: --store FOLDER"))]
    Version {
        /// The store.
        root: PathBuf,
        /// Its version.
        found: String,
    },
    /// Someone else uses a store that must be had alone.
    #[error("another process uses {}", .root.display())]
    #[diagnostic(help("try again when it has ended; nothing was removed"))]
    InUse {
        /// The store.
        root: PathBuf,
    },
    /// A stage that did not leave an output that it declares, or left something else.
    #[error("the stage's output `{output}` cannot be kept: {problem}")]
    Output {
        output: String,
        /// What is wrong with it.
        problem: String,
    },
}

impl StoreError {
    /// Whether the system does not let anything be written here.
    pub fn is_refusal(&self) -> bool {
        use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
        matches!(self, Self::Io { error, .. } if matches!(error.kind(), PermissionDenied | ReadOnlyFilesystem))
    }

    /// Whether somebody else may have removed or written something at the same moment.
    pub fn is_of_a_race(&self) -> bool {
        use io::ErrorKind::{AlreadyExists, DirectoryNotEmpty, NotFound};
        matches!(self, Self::Io { error, .. } if matches!(error.kind(), AlreadyExists | DirectoryNotEmpty | NotFound))
    }
}

/// Says what was tried on which file when it fails.
pub trait At<T> {
    /// `action` is a verb: "read".
    fn at(self, action: &'static str, path: &Path) -> Result<T, StoreError>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, StoreError> {
        self.map_err(|error| StoreError::io(action, path, error))
    }
}

impl StoreError {
    /// `action`, a verb, could not be done to a file.
    pub fn io(action: &'static str, path: &Path, error: io::Error) -> Self {
        let help = advice(error.kind());
        Self::Io {
            action,
            path: path.to_owned(),
            error,
            help,
        }
    }
}

fn advice(kind: io::ErrorKind) -> Option<&'static str> {
    match kind {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Some(
            "the disk is full: free some space, or choose another with --store and --out; all finished results are kept",
        ),
        io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied => {
            Some("choose a folder that can be written: --store FOLDER --out FOLDER")
        }
        _ => None,
    }
}
