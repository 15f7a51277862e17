//! Tensors in files: made up, written, and their shapes read.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::{Value, json};

/// A tensor's type, shape and bytes.
pub type Tensor = (&'static str, Vec<usize>, Vec<u8>);

/// Numbers in [-1, 1), others for each seed.
pub fn reals(seed: usize, shape: &[usize]) -> Tensor {
    let value = |i: usize| (((i + 1) * 7919 + seed * 104_729) % 1000) as f32 / 500.0 - 1.0;
    (
        "F32",
        shape.to_vec(),
        (0..shape.iter().product())
            .flat_map(|i| value(i).to_le_bytes())
            .collect(),
    )
}

pub fn wholes(values: &[i64]) -> Tensor {
    (
        "I64",
        vec![values.len()],
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
    )
}

pub fn save(path: &Path, tensors: &BTreeMap<&str, Tensor>) {
    let mut header = serde_json::Map::new();
    let mut data = Vec::new();
    for (name, (dtype, shape, bytes)) in tensors {
        let start = data.len();
        data.extend(bytes);
        header.insert(
            name.to_string(),
            json!({"dtype": dtype, "shape": shape, "data_offsets": [start, data.len()]}),
        );
    }
    let header = Value::Object(header).to_string().into_bytes();
    fs::write(
        path,
        [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat(),
    )
    .unwrap();
}

/// Names and shapes of a file's tensors.
pub fn shapes(path: &Path) -> BTreeMap<String, Vec<usize>> {
    let bytes = fs::read(path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    file.tensors()
        .into_iter()
        .map(|(name, view)| (name, view.shape().to_vec()))
        .collect()
}
