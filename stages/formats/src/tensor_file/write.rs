//! The bytes of a safetensors file: tensors and metadata in one order only.
//!
//! The `safetensors` crate writes its metadata in random order, so the header is written here.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::tensor::{TensorView, Values};

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

/// What a header says of a tensor, but for where it lies.
struct Described<'a> {
    dtype: &'static str,
    shape: &'a [usize],
    bytes: usize,
}

/// The file of these tensors, sorted by name, the header padded with spaces to 8 bytes.
///
/// # Errors
/// Where values do not fill their shape, and where a tensor has a name that cannot be.
pub fn to_bytes(
    tensors: &BTreeMap<&str, TensorView>,
    metadata: &BTreeMap<&str, String>,
) -> Result<Vec<u8>, WriteError> {
    let mut described = BTreeMap::new();
    for (&name, tensor) in tensors {
        described.insert(name, of_view(name, tensor)?);
    }
    let mut bytes = lines(&described, metadata)?;
    for tensor in tensors.values() {
        bytes.extend(tensor.values.bytes());
    }
    Ok(bytes)
}

/// The first bytes of the file of F32 tensors of these shapes: all but the values, which follow
/// sorted by name.
///
/// # Errors
/// Where a tensor has a name that cannot be, or is larger than any file.
pub fn header(
    shapes: &BTreeMap<&str, &[usize]>,
    metadata: &BTreeMap<&str, String>,
) -> Result<Vec<u8>, WriteError> {
    let mut described = BTreeMap::new();
    for (&name, &shape) in shapes {
        described.insert(name, of_shape(name, shape)?);
    }
    lines(&described, metadata)
}

/// Refuses a tensor that no file can hold.
///
/// # Errors
/// As [`to_bytes`].
pub fn check(name: &str, tensor: &TensorView) -> Result<(), WriteError> {
    of_view(name, tensor).map(|_| ())
}

fn of_view<'a>(name: &str, tensor: &TensorView<'a>) -> Result<Described<'a>, WriteError> {
    check_name(name)?;
    let count = tensor.values.count();
    if product(tensor.shape) != Some(count) {
        let problem = format!("{count} values do not fill the shape {:?}", tensor.shape);
        return Err(WriteError::new(name, problem));
    }
    Ok(Described {
        dtype: tensor.values.dtype(),
        shape: tensor.shape,
        bytes: tensor.values.size(),
    })
}

fn of_shape<'a>(name: &str, shape: &'a [usize]) -> Result<Described<'a>, WriteError> {
    check_name(name)?;
    let bytes = product(shape).and_then(|count| count.checked_mul(size_of::<f32>()));
    Ok(Described {
        dtype: Values::F32(&[]).dtype(),
        shape,
        bytes: bytes.ok_or_else(|| WriteError::new(name, format!("{shape:?} is too large")))?,
    })
}

fn product(shape: &[usize]) -> Option<usize> {
    let mut extents = shape.iter();
    extents.try_fold(1usize, |count, &extent| count.checked_mul(extent))
}

fn check_name(name: &str) -> Result<(), WriteError> {
    if name == METADATA {
        let problem = "has the one name that safetensors keeps for itself";
        return Err(WriteError::new(name, problem));
    }
    Ok(())
}

/// The header, padded, behind its length.
fn lines(
    tensors: &BTreeMap<&str, Described>,
    metadata: &BTreeMap<&str, String>,
) -> Result<Vec<u8>, WriteError> {
    let mut header = entries(tensors);
    if !metadata.is_empty() {
        header.insert(METADATA.to_owned(), json!(metadata));
    }
    let header = crate::json::line(&header).map_err(|error| WriteError::new(METADATA, error))?;
    // So that values begin at a multiple of 8, as the format asks.
    let padded = header.len().next_multiple_of(8);
    let mut bytes = (padded as u64).to_le_bytes().to_vec();
    bytes.extend(header.into_bytes());
    bytes.resize(8 + padded, b' ');
    Ok(bytes)
}

fn entries(tensors: &BTreeMap<&str, Described>) -> Map<String, Value> {
    let mut entries = Map::new();
    let mut end = 0;
    for (&name, tensor) in tensors {
        let begin = end;
        end += tensor.bytes;
        // In the order of the map, by name: offsets and bytes follow the same one.
        let entry = json!({
            "dtype": tensor.dtype, "shape": tensor.shape, "data_offsets": [begin, end],
        });
        entries.insert(name.to_owned(), entry);
    }
    entries
}
