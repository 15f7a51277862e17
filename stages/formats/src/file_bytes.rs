//! What is in one file: in memory, in the program itself, or mapped. Knows no format.

use std::fs::File;
use std::io::{Error, ErrorKind};
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;

use memmap2::Mmap;

/// No deflate stream (PNG, zip in EXR) unpacks to more than this many times its length: what bounds
/// a reader's allocations.
pub const LARGEST_COMPRESSION_RATIO: u64 = 1032;

/// Bytes that several may hold.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// Why there is nothing of a file.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// There is no such file.
    #[error("{file}: is missing")]
    Missing {
        /// The path that was asked for.
        file: String,
    },
    /// A folder or a device.
    #[error("{file}: is not a file")]
    NotAFile {
        /// What was taken for a file.
        file: String,
    },
    /// The file system said no.
    #[error("{file}: cannot be read: {source}")]
    Unreadable {
        /// The path of the file.
        file: String,
        /// What the file system said.
        source: Error,
    },
}

impl FileError {
    fn of(path: &Path, source: Error) -> Self {
        let file = path.display().to_string();
        match source.kind() {
            ErrorKind::NotFound => Self::Missing { file },
            _ => Self::Unreadable { file, source },
        }
    }
}

/// What one file holds. Clones share it.
#[derive(Clone)]
pub struct FileBytes {
    name: String,
    bytes: SharedBytes,
}

impl FileBytes {
    /// A file in memory, which messages call `name`.
    pub fn in_memory(name: impl Into<String>, bytes: Vec<u8>) -> Self {
        Self {
            name: name.into(),
            bytes: Arc::new(bytes),
        }
    }

    /// A file that the program carries.
    pub fn embedded(name: impl Into<String>, bytes: &'static [u8]) -> Self {
        Self {
            name: name.into(),
            bytes: Arc::new(bytes),
        }
    }

    /// The file at `path`, read whole: it may change afterwards.
    ///
    /// # Errors
    /// Where there is none, or it cannot be read.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let bytes = std::fs::read(path).map_err(|source| FileError::of(path, source))?;
        Ok(Self::in_memory(path.display().to_string(), bytes))
    }

    /// The file at `path`, mapped: of large ones only what is used is ever read. It must not change
    /// as long as any clone lives.
    ///
    /// # Errors
    /// Where there is none, or it cannot be read.
    #[allow(unsafe_code)]
    pub fn map(path: &Path) -> Result<Self, FileError> {
        let failed = |source| FileError::of(path, source);
        let file = File::open(path).map_err(failed)?;
        let name = path.display().to_string();
        // A folder or a device can be opened but not mapped, with a message that names no cause.
        if !file.metadata().map_err(failed)?.is_file() {
            return Err(FileError::NotAFile { file: name });
        }
        // SAFETY: the map is read-only and private to this process; model files are not rewritten
        // while they are loaded.
        let map = unsafe { Mmap::map(&file) }.map_err(failed)?;
        Ok(Self {
            name,
            bytes: Arc::new(map),
        })
    }

    /// How messages name the file: its path, where it has one.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The bytes, for those who hold them longer than this.
    pub fn shared(&self) -> SharedBytes {
        self.bytes.clone()
    }
}

impl Deref for FileBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        (*self.bytes).as_ref()
    }
}
