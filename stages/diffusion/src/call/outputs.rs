//! Named results, and the safetensors file of them: sorted by name, the same bytes for the same
//! values.

use std::collections::BTreeMap;

use compute::Array;
use serde_json::{Map, json};

/// One result.
#[derive(Clone, Debug)]
pub enum Output {
    /// `f32`.
    Real(Array),
    /// `i64`, with a shape.
    Whole(Vec<usize>, Vec<i64>),
}

/// Results by name.
pub type Outputs = BTreeMap<String, Output>;

impl Output {
    /// The extents of the axes.
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::Real(array) => array.shape(),
            Self::Whole(shape, _) => shape,
        }
    }

    fn dtype(&self) -> &'static str {
        match self {
            Self::Real(_) => "F32",
            Self::Whole(..) => "I64",
        }
    }

    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Real(array) => array
                .to_vec()
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect(),
            Self::Whole(_, values) => values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect(),
        }
    }
}

/// The safetensors file of `outputs`.
pub fn to_safetensors(outputs: &Outputs) -> Vec<u8> {
    let mut header = Map::new();
    let mut data = Vec::new();
    for (name, output) in outputs {
        let start = data.len();
        data.extend(output.bytes());
        let entry = json!({ "dtype": output.dtype(), "shape": output.shape(), "data_offsets": [start, data.len()] });
        header.insert(name.clone(), entry);
    }
    let mut header = serde_json::Value::Object(header).to_string().into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');
    [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
}
