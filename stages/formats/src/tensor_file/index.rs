//! What the header of a safetensors file says: which tensors there are, and where each lies. Knows
//! no values.

use std::collections::BTreeMap;
use std::ops::Range;

use safetensors::tensor::{Metadata, TensorInfo};
use safetensors::{Dtype, SafeTensorError, SafeTensors};

use super::TensorError;
use crate::Tensor;

/// Bytes of a file before its header: they say how long that is.
pub const BEGIN: usize = 8;
/// The longest header of a sound file.
const LONGEST: u64 = 100_000_000;

/// How many bytes the header has by the first [`BEGIN`] bytes of a file; none where no header can
/// be so long, and where there are fewer bytes.
pub fn header_bytes(begin: &[u8]) -> u64 {
    let bytes = begin.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
    // Nobody should read more of a broken file than there can be.
    if bytes > LONGEST { 0 } else { bytes }
}

/// Where a tensor lies.
#[derive(Clone, Debug)]
pub struct Entry {
    pub(super) dtype: Dtype,
    shape: Vec<usize>,
    bytes: Range<usize>,
}

impl Entry {
    fn of(info: &TensorInfo, start: usize) -> Self {
        let (first, last) = info.data_offsets;
        Self {
            dtype: info.dtype,
            shape: info.shape.clone(),
            bytes: start + first..start + last,
        }
    }

    /// The number type as the file names it: "F16".
    pub fn dtype(&self) -> String {
        format!("{:?}", self.dtype)
    }

    /// The extents of the axes.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Which of the file's bytes hold it.
    pub fn bytes(&self) -> Range<usize> {
        self.bytes.clone()
    }

    /// The tensor of F32 that these bytes of its file hold.
    pub fn tensor(&self, bytes: &[u8]) -> Tensor {
        // The checked header says that the bytes are as many as the shape needs.
        let (values, _) = bytes.as_chunks();
        Tensor {
            shape: self.shape.clone(),
            values: values.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        }
    }
}

/// The tensors of one file, and the texts beside them.
#[derive(Clone, Debug)]
pub struct Index {
    name: String,
    entries: BTreeMap<String, Entry>,
    metadata: BTreeMap<String, String>,
}

impl Index {
    /// The index of a file of `length` bytes by its first ones, which hold at least the header.
    /// Messages call it `name`.
    ///
    /// # Errors
    /// Where the header does not fit the file.
    pub fn new(name: impl Into<String>, begin: &[u8], length: u64) -> Result<Self, TensorError> {
        let file = name.into();
        match checked(begin, length) {
            Ok((header, info)) => Ok(Self::of(file, header, &info)),
            Err(source) => Err(TensorError::Header { file, source }),
        }
    }

    fn of(name: String, header: usize, info: &Metadata) -> Self {
        let tensors = info.tensors().into_iter();
        let entries = tensors.map(|(name, info)| (name, Entry::of(info, BEGIN + header)));
        let metadata = info.metadata().iter().flatten();
        Self {
            name,
            entries: entries.collect(),
            metadata: metadata.map(|(k, v)| (k.clone(), v.clone())).collect(),
        }
    }

    /// How messages name the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The tensors' names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The texts of the file's metadata.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Where the tensor of this name lies.
    ///
    /// # Errors
    /// Where there is none.
    pub fn entry(&self, name: &str) -> Result<&Entry, TensorError> {
        self.entries
            .get(name)
            .ok_or_else(|| self.wrong(name, "is missing"))
    }

    /// Where the tensor of this name lies, whose numbers are F32.
    ///
    /// # Errors
    /// Where there is none, or it holds other numbers.
    pub fn reals(&self, name: &str) -> Result<&Entry, TensorError> {
        let entry = self.entry(name)?;
        match entry.dtype {
            Dtype::F32 => Ok(entry),
            other => Err(self.wrong(name, format!("is {other}; expected F32"))),
        }
    }

    /// For each number type, as the file names it, how many numbers there are.
    pub fn counts(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for entry in self.entries.values() {
            *counts.entry(entry.dtype()).or_default() += entry.shape.iter().product::<usize>();
        }
        counts
    }

    /// An error about the tensor of this name.
    pub fn wrong(&self, name: &str, problem: impl ToString) -> TensorError {
        TensorError::tensor(self.name(), name, problem)
    }
}

/// The length of the header, and what it says: all of it lies within a file of `length` bytes.
fn checked(begin: &[u8], length: u64) -> Result<(usize, Metadata), SafeTensorError> {
    let (header, info) = match SafeTensors::read_metadata(begin) {
        // All that is wrong with a header alone: no values follow it.
        Err(SafeTensorError::MetadataIncompleteBuffer) => alone(begin)?,
        read => read?,
    };
    let end = BEGIN + header + info.data_len();
    match end as u64 == length {
        true => Ok((header, info)),
        false => Err(SafeTensorError::MetadataIncompleteBuffer),
    }
}

/// The header of a file by itself. The crate has found it sound, but for the values behind it.
fn alone(begin: &[u8]) -> Result<(usize, Metadata), SafeTensorError> {
    let header = header_bytes(begin) as usize;
    let info = serde_json::from_slice(&begin[BEGIN..BEGIN + header]);
    let info = info.map_err(SafeTensorError::InvalidHeaderDeserialization)?;
    Ok((header, info))
}
