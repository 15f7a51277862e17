//! safetensors files: f32 tensors and string metadata, in one order only.
//!
//! The `safetensors` crate reads; it writes its metadata in random order, so the header is written
//! here. Knows nothing of what the tensors mean.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use serde::de::DeserializeOwned;
use serde_json::json;

use crate::error::SchemaError;
use crate::tensor::Tensor;

/// The metadata key under which our own JSON lies.
pub const METADATA_KEY: &str = "srnerf";

/// Writes a file: tensors and metadata sorted by name, the header padded with spaces to 8 bytes.
pub fn write(
    folder: &Path,
    file: &str,
    tensors: &BTreeMap<&str, &Tensor>,
    metadata: &BTreeMap<&str, String>,
) -> Result<(), SchemaError> {
    let header = header(tensors, metadata)?;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    for tensor in tensors.values() {
        let values: Vec<[u8; 4]> = tensor
            .values
            .iter()
            .map(|value| value.to_le_bytes())
            .collect();
        bytes.extend_from_slice(values.as_flattened());
    }
    crate::canonical::write(folder, file, &bytes)
}

fn header(
    tensors: &BTreeMap<&str, &Tensor>,
    metadata: &BTreeMap<&str, String>,
) -> Result<Vec<u8>, SchemaError> {
    let mut header = serde_json::Map::new();
    let mut end = 0;
    for (&name, tensor) in tensors {
        tensor.check(&format!("tensor {name:?}"))?;
        let begin = end;
        end += 4 * tensor.values.len();
        header.insert(
            name.to_owned(),
            json!({ "dtype": "F32", "shape": tensor.shape, "data_offsets": [begin, end] }),
        );
    }
    if header
        .insert("__metadata__".to_owned(), json!(metadata))
        .is_some()
    {
        return Err(SchemaError::content(
            "tensor \"__metadata__\"",
            "has the one name that safetensors keeps for itself",
        ));
    }
    let mut header = crate::canonical::line(&header)?.into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');
    Ok(header)
}

/// Owned tensors as [`write`] takes them.
pub fn by_name(tensors: &BTreeMap<String, Tensor>) -> BTreeMap<&str, &Tensor> {
    tensors
        .iter()
        .map(|(name, tensor)| (name.as_str(), tensor))
        .collect()
}

/// What a file holds.
pub struct TensorFile {
    /// The tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// The string metadata.
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Reads a file. Nothing is allocated that the file does not hold.
    pub fn read(path: &Path) -> Result<Self, SchemaError> {
        let bytes = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
        let malformed = |error: SafeTensorError| SchemaError::malformed(path, "header", error);
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(malformed)?;
        let metadata = header
            .metadata()
            .iter()
            .flatten()
            .map(|(key, text)| (key.clone(), text.clone()))
            .collect();
        let views = SafeTensors::deserialize(&bytes).map_err(malformed)?;
        let tensor =
            |(name, view): (&str, TensorView)| Ok((name.to_owned(), tensor(path, name, &view)?));
        Ok(Self {
            tensors: views
                .iter()
                .map(tensor)
                .collect::<Result<_, SchemaError>>()?,
            metadata,
        })
    }

    /// Our own JSON in the metadata.
    pub fn header<T: DeserializeOwned>(&self, path: &Path) -> Result<T, SchemaError> {
        let place = format!("metadata {METADATA_KEY:?}");
        let text = self
            .metadata
            .get(METADATA_KEY)
            .ok_or_else(|| SchemaError::malformed(path, &place, "is missing"))?;
        serde_json::from_str(text).map_err(|error| SchemaError::malformed(path, &place, error))
    }

    /// Takes out the tensor of this name.
    pub fn take(&mut self, path: &Path, name: &str) -> Result<Tensor, SchemaError> {
        self.tensors
            .remove(name)
            .ok_or_else(|| SchemaError::malformed(path, format!("tensor {name:?}"), "is missing"))
    }

    /// Refuses tensors that nobody took.
    pub fn finish(self, path: &Path) -> Result<(), SchemaError> {
        match self.tensors.keys().next() {
            Some(name) => Err(SchemaError::malformed(
                path,
                format!("tensor {name:?}"),
                "is not in the metadata",
            )),
            None => Ok(()),
        }
    }
}

fn tensor(path: &Path, name: &str, view: &TensorView) -> Result<Tensor, SchemaError> {
    if view.dtype() != Dtype::F32 {
        let problem = format!("is {}; expected F32", view.dtype());
        return Err(SchemaError::malformed(
            path,
            format!("tensor {name:?}"),
            problem,
        ));
    }
    let (values, _) = view.data().as_chunks::<4>();
    Ok(Tensor {
        shape: view.shape().to_vec(),
        values: values
            .iter()
            .map(|&bytes| f32::from_le_bytes(bytes))
            .collect(),
    })
}
