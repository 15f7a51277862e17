//! Reads tensors out of a safetensors file, widened to `f32`.
//!
//! Knows names, shapes and number formats; not what a tensor is for. Nothing is allocated before the header has been checked
//! against the file's size.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use compute::{Array, Device};
use half::slice::HalfFloatSliceExt;
use half::{bf16, f16};
use rayon::prelude::*;
use safetensors::{Dtype, SafeTensors};

use crate::error::ModelError;
use crate::source::ModelFile;

/// Elements that one task widens.
const CHUNK: usize = 1 << 16;

struct Entry {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Range<usize>,
}

/// An open weight file.
pub(crate) struct Weights {
    file: ModelFile,
    device: Device,
    entries: BTreeMap<String, Entry>,
    unread: RefCell<BTreeSet<String>>,
}

impl Weights {
    /// Reads the header of `file`. Fails where header and file do not fit together.
    pub fn open(file: ModelFile, device: &Device) -> Result<Self, ModelError> {
        let (header, metadata) = SafeTensors::read_metadata(&file)
            .map_err(|e| ModelError::file(&file.name, format!("is not a sound safetensors file: {e}")))?;
        let start = 8 + header;
        let entries: BTreeMap<_, _> = metadata
            .tensors()
            .into_iter()
            .map(|(name, info)| {
                let (first, last) = info.data_offsets;
                (name, Entry { dtype: info.dtype, shape: info.shape.clone(), bytes: start + first..start + last })
            })
            .collect();
        let unread = RefCell::new(entries.keys().cloned().collect());
        Ok(Self { file, device: device.clone(), entries, unread })
    }

    /// The root of all names.
    pub fn root(&self) -> Scope<'_> {
        Scope { weights: self, path: String::new() }
    }

    /// Renames tensors; for files written under older names.
    pub fn rename(&mut self, new_name: impl Fn(&str) -> String) {
        self.entries =
            std::mem::take(&mut self.entries).into_iter().map(|(old, entry)| (new_name(&old), entry)).collect();
        self.unread = RefCell::new(self.entries.keys().cloned().collect());
    }

    /// Fails if the file holds a tensor that nothing has asked for, except those whose name ends with one of `ignored`.
    pub fn finish(self, ignored: &[&str]) -> Result<(), ModelError> {
        let unread = self.unread.into_inner();
        match unread.iter().find(|name| !ignored.iter().any(|end| name.ends_with(end))) {
            Some(name) => Err(ModelError::tensor(&self.file.name, name, "belongs to no layer of the configuration")),
            None => Ok(()),
        }
    }

    fn tensor(&self, name: &str, shape: &[usize]) -> Result<Array, ModelError> {
        let wrong = |problem: String| ModelError::tensor(&self.file.name, name, problem);
        let entry = self.entries.get(name).ok_or_else(|| wrong(format!("of shape {shape:?} is missing")))?;
        // Attention of old files keeps its linear weights as 1x1 convolutions.
        let extents: &[usize] = match &entry.shape[..] {
            [outputs, inputs, 1, 1] if shape == [*outputs, *inputs] => shape,
            other => other,
        };
        if extents != shape {
            return Err(wrong(format!("has the shape {extents:?}; the configuration asks for {shape:?}")));
        }
        let values = widen(entry.dtype, &self.file[entry.bytes.clone()])
            .ok_or_else(|| wrong(format!("is {:?}; supported are F32, F16 and BF16", entry.dtype)))?;
        if let Some(index) = values.par_iter().position_first(|v| !v.is_finite()) {
            return Err(wrong(format!("is {} at element {index}", values[index])));
        }
        self.unread.borrow_mut().remove(name);
        Ok(self.device.array(shape, values))
    }
}

/// A place in the tree of tensor names.
#[derive(Clone)]
pub(crate) struct Scope<'a> {
    weights: &'a Weights,
    path: String,
}

impl Scope<'_> {
    /// The place `name` below this one; `name` may have several parts.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        let path = if self.path.is_empty() { name.to_string() } else { format!("{}.{name}", self.path) };
        Self { weights: self.weights, path }
    }

    /// This place's full name.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Whether the file holds the tensor `name` below this place.
    pub fn has(&self, name: &str) -> bool {
        self.weights.entries.contains_key(self.at(name).path())
    }

    /// The tensor `name` below this place, of exactly this shape. Fails if it is missing, of another shape or not finite.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Array, ModelError> {
        self.weights.tensor(self.at(name).path(), shape)
    }
}

/// Little-endian numbers as `f32`; `None` for a format that is not read.
fn widen(dtype: Dtype, bytes: &[u8]) -> Option<Vec<f32>> {
    let width = match dtype {
        Dtype::F32 => 4,
        Dtype::F16 | Dtype::BF16 => 2,
        _ => return None,
    };
    let mut values = vec![0.0f32; bytes.len() / width];
    values.par_chunks_mut(CHUNK).zip(bytes.par_chunks(width * CHUNK)).for_each(|(out, bytes)| match dtype {
        Dtype::F32 => out.iter_mut().zip(bytes.as_chunks().0).for_each(|(v, b)| *v = f32::from_le_bytes(*b)),
        Dtype::F16 => halves(bytes, f16::from_le_bytes).convert_to_f32_slice(out),
        _ => halves(bytes, bf16::from_le_bytes).convert_to_f32_slice(out),
    });
    Some(values)
}

fn halves<H>(bytes: &[u8], read: impl Fn([u8; 2]) -> H) -> Vec<H> {
    bytes.as_chunks().0.iter().map(|b| read(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::ModelSource;

    /// A weight file with this header and so many bytes of data.
    fn open(header: &str, data: &[u8]) -> Result<Weights, ModelError> {
        let bytes = [&(header.len() as u64).to_le_bytes(), header.as_bytes(), data].concat();
        open_bytes(&bytes)
    }

    fn open_bytes(bytes: &[u8]) -> Result<Weights, ModelError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("w.safetensors"), bytes).unwrap();
        let file = ModelSource::Folder(folder.path().to_owned()).file("w.safetensors").unwrap();
        Weights::open(file, &Device::cpu())
    }

    fn read(dtype: &str, data: &[u8], shape: &[usize]) -> Result<Vec<f32>, String> {
        let header = format!(r#"{{"a.w":{{"dtype":"{dtype}","shape":[2],"data_offsets":[0,{}]}}}}"#, data.len());
        let weights = open(&header, data).map_err(|e| e.to_string())?;
        let tensor = weights.root().at("a").tensor("w", shape).map_err(|e| e.to_string())?;
        weights.finish(&[]).map_err(|e| e.to_string())?;
        Ok(tensor.to_vec())
    }

    #[test]
    fn three_formats_are_widened() {
        assert_eq!(read("F32", &[0, 0, 128, 63, 0, 0, 0, 192], &[2]).unwrap(), [1.0, -2.0]);
        assert_eq!(read("F16", &[0, 60, 0, 192], &[2]).unwrap(), [1.0, -2.0]);
        assert_eq!(read("BF16", &[128, 63, 0, 192], &[2]).unwrap(), [1.0, -2.0]);
    }

    #[test]
    fn a_tensor_that_does_not_fit_is_named() {
        let says = |result: Result<Vec<f32>, String>, text: &str| {
            let message = result.unwrap_err();
            assert!(message.contains("w.safetensors: tensor `a.w`") && message.contains(text), "{message}");
        };
        says(read("F16", &[0, 60, 0, 192], &[3]), "has the shape [2]; the configuration asks for [3]");
        says(read("I16", &[0, 60, 0, 192], &[2]), "is I16; supported are F32, F16 and BF16");
        says(read("F16", &[0, 60, 0, 0x7e], &[2]), "is NaN at element 1");
    }

    #[test]
    fn a_missing_and_a_needless_tensor_are_named() {
        let weights = open(r#"{"w":{"dtype":"F16","shape":[1],"data_offsets":[0,2]}}"#, &[0, 0]).unwrap();
        let missing = weights.root().tensor("b", &[4]).unwrap_err().to_string();
        assert!(missing.contains("tensor `b` of shape [4] is missing"), "{missing}");
        let extra = weights.finish(&["x"]).unwrap_err().to_string();
        assert!(extra.contains("tensor `w` belongs to no layer"), "{extra}");
    }

    #[test]
    fn broken_headers_give_one_clear_error() {
        let huge = format!(r#"{{"w":{{"dtype":"F32","shape":[{}],"data_offsets":[0,4]}}}}"#, u64::MAX);
        let beyond = r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[0,16]}}"#;
        let hole = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#;
        let results = [
            open_bytes(&[]),
            open_bytes(&[1, 2, 3]),
            open_bytes(&u64::MAX.to_le_bytes()),
            open_bytes(&[9, 0, 0, 0, 0, 0, 0, 0, b'{']),
            open("not json", &[]),
            open(&huge, &[0; 4]),
            open(beyond, &[0; 4]),
            open(hole, &[0; 8]),
        ];
        for (case, result) in results.into_iter().enumerate() {
            let message = result.err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains("w.safetensors: is not a sound safetensors file: "), "case {case}: {message}");
        }
    }
}
