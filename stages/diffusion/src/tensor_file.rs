//! One safetensors file: named tensors in a memory map, read when they are asked for.
//!
//! Knows names, shapes and number formats; not what a tensor is for. Nothing is allocated before
//! the header has been checked against the file's size.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use compute::{Array, Device, Format, Weight};
use safetensors::{Dtype, SafeTensors};

use crate::error::ModelError;
use crate::source::ModelFile;

/// Where a tensor lies.
#[derive(Clone, Debug)]
struct Entry {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Range<usize>,
}

/// An open safetensors file.
pub struct TensorFile {
    file: Arc<ModelFile>,
    entries: BTreeMap<String, Entry>,
    metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Opens the file at `path`. Fails where there is none, and where header and file do not fit
    /// together.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        Self::new(ModelFile::open(path)?)
    }

    /// The tensors of `file`. Fails where its header does not fit it.
    pub fn new(file: ModelFile) -> Result<Self, ModelError> {
        let (header, info) = SafeTensors::read_metadata(&file).map_err(|e| {
            ModelError::file(&file.name, format!("is not a sound safetensors file: {e}"))
        })?;
        let start = 8 + header;
        let entry = |(name, info): (String, &safetensors::tensor::TensorInfo)| {
            let (first, last) = info.data_offsets;
            (
                name,
                Entry {
                    dtype: info.dtype,
                    shape: info.shape.clone(),
                    bytes: start + first..start + last,
                },
            )
        };
        let entries = info.tensors().into_iter().map(entry).collect();
        let metadata = info
            .metadata()
            .iter()
            .flatten()
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        Ok(Self {
            file: Arc::new(file),
            entries,
            metadata,
        })
    }

    /// How messages name the file.
    pub fn name(&self) -> &str {
        &self.file.name
    }

    /// The file's size.
    pub fn bytes(&self) -> usize {
        self.file.len()
    }

    /// The tensors' names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// A text of the file's metadata.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    /// The tensor of this name as it lies in the file, which stays mapped. Fails where there is
    /// none, where it holds other numbers than F32, F16 or BF16, and where one of them is not
    /// finite.
    pub fn weight(&self, name: &str, device: &Device) -> Result<Weight, ModelError> {
        let (entry, _) = self.find(name)?;
        let format = match entry.dtype {
            Dtype::F32 => Format::F32,
            Dtype::F16 => Format::F16,
            Dtype::BF16 => Format::Bf16,
            other => {
                return Err(self.wrong(
                    name,
                    format!("is {other:?}; supported are F32, F16 and BF16"),
                ));
            }
        };
        let weight = Weight::from_bytes(
            device,
            &entry.shape,
            format,
            self.file.clone(),
            entry.bytes.clone(),
        );
        match weight.first_not_finite() {
            Some((index, value)) => Err(self.wrong(name, format!("is {value} at element {index}"))),
            None => Ok(weight),
        }
    }

    /// [`TensorFile::weight`] in an array of its own.
    pub fn real(&self, name: &str, device: &Device) -> Result<Array, ModelError> {
        Ok(self.weight(name, device)?.to_array())
    }

    /// The shape and the values of a tensor of whole numbers, I64 or I32.
    pub fn whole(&self, name: &str) -> Result<(Vec<usize>, Vec<i64>), ModelError> {
        let (entry, bytes) = self.find(name)?;
        let values = match entry.dtype {
            Dtype::I64 => bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| i64::from_le_bytes(*b))
                .collect(),
            Dtype::I32 => bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| i32::from_le_bytes(*b).into())
                .collect(),
            other => {
                return Err(self.wrong(name, format!("is {other:?}; supported are I64 and I32")));
            }
        };
        Ok((entry.shape.clone(), values))
    }

    /// The extents of the axes of a tensor; `None` where there is none of this name.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.entries.get(name).map(|entry| &entry.shape[..])
    }

    /// For each number type, as the file names it, how many numbers there are.
    pub fn counts(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for entry in self.entries.values() {
            *counts.entry(format!("{:?}", entry.dtype)).or_default() +=
                entry.shape.iter().product::<usize>();
        }
        counts
    }

    pub(crate) fn wrong(&self, name: &str, problem: impl Into<String>) -> ModelError {
        ModelError::tensor(&self.file.name, name, problem)
    }

    fn find(&self, name: &str) -> Result<(&Entry, &[u8]), ModelError> {
        let entry = self
            .entries
            .get(name)
            .ok_or_else(|| self.wrong(name, "is missing"))?;
        Ok((entry, &self.file[entry.bytes.clone()]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with this header and this data.
    fn open(header: &str, data: &[u8]) -> Result<TensorFile, ModelError> {
        open_bytes(
            &[
                &(header.len() as u64).to_le_bytes(),
                header.as_bytes(),
                data,
            ]
            .concat(),
        )
    }

    fn open_bytes(bytes: &[u8]) -> Result<TensorFile, ModelError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("w.safetensors"), bytes).unwrap();
        TensorFile::open(&folder.path().join("w.safetensors"))
    }

    fn pair(dtype: &str, data: &[u8]) -> TensorFile {
        open(
            &format!(
                r#"{{"a.w":{{"dtype":"{dtype}","shape":[2],"data_offsets":[0,{}]}}}}"#,
                data.len()
            ),
            data,
        )
        .unwrap()
    }

    fn real(dtype: &str, data: &[u8]) -> Result<Vec<f32>, String> {
        pair(dtype, data)
            .real("a.w", &Device::cpu())
            .map(|array| array.to_vec())
            .map_err(|e| e.to_string())
    }

    #[test]
    fn three_formats_are_widened() {
        assert_eq!(
            real("F32", &[0, 0, 128, 63, 0, 0, 0, 192]).unwrap(),
            [1.0, -2.0]
        );
        assert_eq!(real("F16", &[0, 60, 0, 192]).unwrap(), [1.0, -2.0]);
        assert_eq!(real("BF16", &[128, 63, 0, 192]).unwrap(), [1.0, -2.0]);
    }

    #[test]
    fn whole_numbers_have_two_widths() {
        assert_eq!(
            pair("I32", &[1, 0, 0, 0, 255, 255, 255, 255])
                .whole("a.w")
                .unwrap(),
            (vec![2], vec![1, -1])
        );
        let wide = [[7u8, 0, 0, 0, 0, 0, 0, 0], [255; 8]].concat();
        assert_eq!(
            pair("I64", &wide).whole("a.w").unwrap(),
            (vec![2], vec![7, -1])
        );
        let message = pair("F16", &[0; 4]).whole("a.w").unwrap_err().to_string();
        assert!(
            message.ends_with("tensor `a.w` is F16; supported are I64 and I32"),
            "{message}"
        );
    }

    #[test]
    fn a_tensor_that_cannot_be_used_is_named() {
        let says = |result: Result<Vec<f32>, String>, text: &str| {
            let message = result.unwrap_err();
            assert!(
                message.contains("w.safetensors: tensor `a.w`") && message.contains(text),
                "{message}"
            );
        };
        says(
            real("I16", &[0, 60, 0, 192]),
            "is I16; supported are F32, F16 and BF16",
        );
        says(real("F16", &[0, 60, 0, 0x7e]), "is NaN at element 1");
        says(
            real("F32", &[0, 0, 128, 127, 0, 0, 0, 0]),
            "is inf at element 0",
        );
    }

    #[test]
    fn broken_headers_give_one_clear_error() {
        let huge = format!(
            r#"{{"w":{{"dtype":"F32","shape":[{}],"data_offsets":[0,4]}}}}"#,
            u64::MAX
        );
        let beyond = r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[0,16]}}"#;
        let hole = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#;
        let overlap = r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#;
        let backwards = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[8,4]}}"#;
        let results = [
            open_bytes(&[]),
            open_bytes(&[1, 2, 3]),
            open_bytes(&u64::MAX.to_le_bytes()),
            open_bytes(&[9, 0, 0, 0, 0, 0, 0, 0, b'{']),
            open("not json", &[]),
            open(&huge, &[0; 4]),
            open(beyond, &[0; 4]),
            open(hole, &[0; 8]),
            open(overlap, &[0; 8]),
            open(backwards, &[0; 8]),
        ];
        for (case, result) in results.into_iter().enumerate() {
            let message = result.err().map(|e| e.to_string()).unwrap_or_default();
            assert!(
                message.contains("w.safetensors: is not a sound safetensors file: "),
                "case {case}: {message}"
            );
        }
    }
}
