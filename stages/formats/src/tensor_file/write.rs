//! The bytes of a safetensors file: tensors and metadata in one order only.
//!
//! The `safetensors` crate writes its metadata in random order, so the header is written here.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::tensor::TensorView;

/// Where the metadata stand in the header.
const METADATA: &str = "__metadata__";

/// Why tensors cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("tensor {tensor:?}: {problem}")]
pub struct WriteError {
    /// The name of the tensor that is refused.
    pub tensor: String,
    /// What is wrong with it.
    pub problem: String,
}

impl WriteError {
    fn new(tensor: &str, problem: impl ToString) -> Self {
        Self {
            tensor: tensor.to_owned(),
            problem: problem.to_string(),
        }
    }
}

/// The file of these tensors, sorted by name, the header padded with spaces to 8 bytes.
///
/// # Errors
/// Where values do not fill their shape, and where a tensor has a name that cannot be.
pub fn to_bytes(
    tensors: &BTreeMap<&str, TensorView>,
    metadata: &BTreeMap<&str, String>,
) -> Result<Vec<u8>, WriteError> {
    let mut header = entries(tensors)?;
    if !metadata.is_empty() {
        header.insert(METADATA.to_owned(), json!(metadata));
    }
    let header = crate::json::line(&header).map_err(|error| WriteError::new(METADATA, error))?;
    // So that values begin at a multiple of 8, as the format asks.
    let padded = header.len().next_multiple_of(8);
    let mut bytes = (padded as u64).to_le_bytes().to_vec();
    bytes.extend(header.into_bytes());
    bytes.resize(8 + padded, b' ');
    for tensor in tensors.values() {
        bytes.extend(tensor.values.bytes());
    }
    Ok(bytes)
}

fn entries(tensors: &BTreeMap<&str, TensorView>) -> Result<Map<String, Value>, WriteError> {
    let mut entries = Map::new();
    let mut end = 0;
    for (&name, tensor) in tensors {
        check(name, tensor)?;
        let begin = end;
        end += tensor.values.size();
        let dtype = tensor.values.dtype();
        // In the order of the map, by name: offsets and bytes follow the same one.
        let entry = json!({ "dtype": dtype, "shape": tensor.shape, "data_offsets": [begin, end] });
        entries.insert(name.to_owned(), entry);
    }
    Ok(entries)
}

fn check(name: &str, tensor: &TensorView) -> Result<(), WriteError> {
    if name == METADATA {
        let problem = "has the one name that safetensors keeps for itself";
        return Err(WriteError::new(name, problem));
    }
    let mut extents = tensor.shape.iter();
    let fills = extents.try_fold(1usize, |count, &extent| count.checked_mul(extent));
    let count = tensor.values.count();
    if fills == Some(count) {
        return Ok(());
    }
    let problem = format!("{count} values do not fill the shape {:?}", tensor.shape);
    Err(WriteError::new(name, problem))
}
