//! One safetensors file: named tensors, read when they are asked for, out of a map or out of
//! memory.
//!
//! Knows names, shapes and number types; not what a tensor is for. Nothing is allocated before
//! the header has been checked against the file's size.

mod error;
mod index;
mod write;

use std::ops::Deref;

use safetensors::Dtype;

use crate::{FileBytes, Tensor};

pub use error::TensorError;
pub use index::{BEGIN, Entry, Index, header_bytes};
pub use write::{WriteError, check, header, to_bytes};

/// An open safetensors file.
pub struct TensorFile {
    file: FileBytes,
    index: Index,
}

impl TensorFile {
    /// The tensors of `file`.
    ///
    /// # Errors
    /// Where its header does not fit it.
    pub fn new(file: FileBytes) -> Result<Self, TensorError> {
        Ok(Self {
            index: Index::new(file.name(), &file, file.len() as u64)?,
            file,
        })
    }

    /// What the file holds.
    pub fn file(&self) -> &FileBytes {
        &self.file
    }

    /// The shape and the values of a tensor of F32.
    ///
    /// # Errors
    /// Where there is none of this name, or it holds other numbers.
    pub fn tensor(&self, name: &str) -> Result<Tensor, TensorError> {
        let entry = self.reals(name)?;
        Ok(entry.tensor(&self.file[entry.bytes()]))
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
        Ok((entry.shape().to_vec(), values))
    }
}

impl Deref for TensorFile {
    type Target = Index;

    fn deref(&self) -> &Index {
        &self.index
    }
}

#[cfg(test)]
mod tests;
