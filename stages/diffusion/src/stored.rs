//! A tensor as a file stores it: all of it, or a third of its rows where a file keeps three in one.
//!
//! Hands out what stays in the file's map. Knows no layer.

use std::ops::Range;

use compute::{Array, Device, Weight};
use formats::tensor_file::Entry;
use formats::{TensorError, TensorFile};

use crate::error::ModelError;

/// Where a tensor is: under which name, and in which third of the rows there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    pub name: String,
    /// 0, 1 or 2; `None` for all rows.
    pub third: Option<usize>,
}

impl Stored {
    /// All of the tensor of this name.
    pub fn whole(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            third: None,
        }
    }

    /// The extents of what it takes of the file's tensor; `None` where that has no thirds.
    pub fn shape(&self, entry: &Entry) -> Option<Vec<usize>> {
        let mut shape = entry.shape().to_vec();
        if self.third.is_some() {
            let rows = shape.first_mut().filter(|rows| rows.is_multiple_of(3))?;
            *rows /= 3;
        }
        Some(shape)
    }

    fn bytes(&self, entry: &Entry) -> Range<usize> {
        let all = entry.bytes();
        match self.third {
            Some(third) => {
                // Rows lie one behind the other, so a third of the rows is a third of the bytes.
                let length = all.len() / 3;
                let start = all.start + third * length;
                start..start + length
            }
            None => all,
        }
    }

    /// Its numbers as they lie in the file, which stays mapped. Fails where there are none, where
    /// they are others than F32, F16 or BF16, and where one of them is not finite.
    pub fn weight(&self, file: &TensorFile, device: &Device) -> Result<Weight, TensorError> {
        let entry = file.entry(&self.name)?;
        let shape = self.shape(entry).ok_or_else(|| {
            let problem = format!(
                "has the shape {:?}, which is no three in one",
                entry.shape()
            );
            file.wrong(&self.name, problem)
        })?;
        let owner = file.file().shared();
        Weight::stored(device, &shape, &entry.dtype(), owner, self.bytes(entry))
            .map_err(|fault| file.wrong(&self.name, fault))
    }
}

/// The real numbers of this name in an array of their own.
pub fn array(file: &TensorFile, name: &str, device: &Device) -> Result<Array, ModelError> {
    Ok(Stored::whole(name).weight(file, device)?.to_array())
}
