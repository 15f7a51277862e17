//! One safetensors file: named tensors, read when they are asked for, out of a map or out of
//! memory.
//!
//! Knows names, shapes and number types; not what a tensor is for. Nothing is allocated before
//! the header has been checked against the file's size.

mod error;
mod write;

use std::collections::BTreeMap;
use std::ops::Range;

use safetensors::tensor::TensorInfo;
use safetensors::{Dtype, SafeTensors};

use crate::{FileBytes, Tensor};

pub use error::TensorError;
pub use write::{WriteError, to_bytes};

/// Where a tensor lies.
#[derive(Clone, Debug)]
pub struct Entry {
    dtype: Dtype,
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
}

/// An open safetensors file.
pub struct TensorFile {
    file: FileBytes,
    entries: BTreeMap<String, Entry>,
    metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// The tensors of `file`.
    ///
    /// # Errors
    /// Where its header does not fit it.
    pub fn new(file: FileBytes) -> Result<Self, TensorError> {
        // The crate checks all offsets against the file, so ranges below cannot be outside.
        let (header, info) =
            SafeTensors::read_metadata(&file).map_err(|source| TensorError::Header {
                file: file.name().to_owned(),
                source,
            })?;
        let tensors = info.tensors().into_iter();
        let entries = tensors
            // Behind the header and its length of 8 bytes.
            .map(|(name, info)| (name, Entry::of(info, 8 + header)))
            .collect();
        let metadata = info.metadata().iter().flatten();
        Ok(Self {
            entries,
            metadata: metadata.map(|(k, v)| (k.clone(), v.clone())).collect(),
            file,
        })
    }

    /// How messages name the file.
    pub fn name(&self) -> &str {
        self.file.name()
    }

    /// What the file holds.
    pub fn file(&self) -> &FileBytes {
        &self.file
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

    /// The shape and the values of a tensor of F32.
    ///
    /// # Errors
    /// Where there is none of this name, or it holds other numbers.
    pub fn tensor(&self, name: &str) -> Result<Tensor, TensorError> {
        let entry = self.entry(name)?;
        if entry.dtype != Dtype::F32 {
            return Err(self.wrong(name, format!("is {}; expected F32", entry.dtype)));
        }
        // The checked header says that the bytes are as many as the shape needs.
        let (values, _) = self.file[entry.bytes()].as_chunks();
        Ok(Tensor {
            shape: entry.shape.clone(),
            values: values.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        })
    }

    /// The shape and the values of a tensor of whole numbers, I64 or I32.
    ///
    /// # Errors
    /// Where there is none of this name, or it holds other numbers.
    pub fn whole(&self, name: &str) -> Result<(Vec<usize>, Vec<i64>), TensorError> {
        let entry = self.entry(name)?;
        let bytes = &self.file[entry.bytes()];
        let i64s = || bytes.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b));
        let i32s = || bytes.as_chunks().0.iter().map(|b| i32::from_le_bytes(*b));
        let values = match entry.dtype {
            Dtype::I64 => i64s().collect(),
            Dtype::I32 => i32s().map(i64::from).collect(),
            other => {
                return Err(self.wrong(name, format!("is {other:?}; supported are I64 and I32")));
            }
        };
        Ok((entry.shape.clone(), values))
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

#[cfg(test)]
mod tests;
