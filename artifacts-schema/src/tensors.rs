//! The safetensors files of artifacts: f32 tensors, and our own JSON in the metadata. Knows nothing
//! of what the tensors mean.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use formats::tensor_file::{self, Index, WriteError};
use formats::{FileBytes, Tensor, TensorError, TensorFile};
use serde::de::DeserializeOwned;

use crate::canonical;
use crate::error::SchemaError;

/// The metadata key under which our own JSON lies.
pub const METADATA_KEY: &str = "srnerf";

/// Writes a file into a folder.
pub fn write<'a>(
    folder: &Path,
    file: &str,
    tensors: impl Iterator<Item = (&'a str, &'a Tensor)>,
    metadata: &BTreeMap<&str, String>,
) -> Result<(), SchemaError> {
    let views = tensors.map(|(name, tensor)| (name, tensor.view()));
    // Collected into a sorted map: the file does not depend on the order in which tensors come.
    let bytes = tensor_file::to_bytes(&views.collect(), metadata)?;
    canonical::write(folder, file, &bytes)
}

/// Owned tensors as [`write`] takes them.
pub fn by_name(tensors: &BTreeMap<String, Tensor>) -> impl Iterator<Item = (&str, &Tensor)> {
    tensors.iter().map(|(name, tensor)| (name.as_str(), tensor))
}

/// Opens a safetensors file, read whole. Fails if its header is none.
pub fn open(path: &Path) -> Result<TensorFile, SchemaError> {
    // Read whole and not mapped: a file that is cut short under a map ends the program.
    let bytes = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
    let file = FileBytes::in_memory(path.display().to_string(), bytes);
    Ok(TensorFile::new(file)?)
}

/// All tensors of a file.
pub fn all(file: &TensorFile) -> Result<BTreeMap<String, Tensor>, SchemaError> {
    let tensor = |name: &str| Ok((name.to_owned(), file.tensor(name)?));
    file.names().map(tensor).collect()
}

/// A safetensors file of which the header alone is in memory.
#[derive(Clone, Debug)]
pub struct StoredTensors {
    path: PathBuf,
    index: Index,
}

impl StoredTensors {
    /// The file at `path`. Fails if its header is none, or does not fit it.
    pub fn open(path: &Path) -> Result<Self, SchemaError> {
        let (begin, length) = begin(path).map_err(|error| SchemaError::io(path, error))?;
        Ok(Self {
            index: Index::new(path.display().to_string(), &begin, length)?,
            path: path.to_owned(),
        })
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Which tensors there are.
    pub fn index(&self) -> &Index {
        &self.index
    }

    /// The tensor of this name, read now.
    pub fn tensor(&self, name: &str) -> Result<Tensor, SchemaError> {
        let entry = self.index.reals(name)?;
        let bytes = part(&self.path, entry.bytes());
        let bytes = bytes.map_err(|error| SchemaError::io(&self.path, error))?;
        Ok(entry.tensor(&bytes))
    }
}

/// What a file holds up to the end of its header, and the length of the whole.
fn begin(path: &Path) -> io::Result<(Vec<u8>, u64)> {
    let mut file = File::open(path)?;
    let mut begin = Vec::new();
    // A file that is shorter than it should be ends these early, and its index says so.
    let mut first = (&mut file).take(tensor_file::BEGIN as u64);
    first.read_to_end(&mut begin)?;
    let header = tensor_file::header_bytes(&begin);
    (&mut file).take(header).read_to_end(&mut begin)?;
    Ok((begin, file.metadata()?.len()))
}

/// Some bytes of a file, which are known to lie within it.
fn part(path: &Path, bytes: Range<usize>) -> io::Result<Vec<u8>> {
    let mut part = vec![0; bytes.len()];
    // Opened anew each time: several threads may read one file, each at its place.
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(bytes.start as u64))?;
    file.read_exact(&mut part)?;
    Ok(part)
}

/// Our own JSON in a file's metadata.
pub fn header<T: DeserializeOwned>(file: &Index) -> Result<T, SchemaError> {
    let path = Path::new(file.name());
    let place = format!("metadata {METADATA_KEY:?}");
    let text = file.metadata().get(METADATA_KEY);
    let text = text.ok_or_else(|| SchemaError::malformed(path, &place, "is missing"))?;
    serde_json::from_str(text).map_err(|error| SchemaError::malformed(path, &place, error))
}

impl From<TensorError> for SchemaError {
    fn from(error: TensorError) -> Self {
        match error {
            TensorError::Header { file, source } => {
                Self::malformed(Path::new(&file), "header", source)
            }
            TensorError::Tensor {
                file,
                tensor,
                problem,
            } => Self::malformed(Path::new(&file), format!("tensor {tensor:?}"), problem),
        }
    }
}

impl From<WriteError> for SchemaError {
    fn from(WriteError { tensor, problem }: WriteError) -> Self {
        Self::content(format!("tensor {tensor:?}"), problem)
    }
}
