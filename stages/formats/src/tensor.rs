//! Numbers with a shape. Knows no files.

/// A dense f32 tensor, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensor {
    /// The extent of each dimension.
    pub shape: Vec<usize>,
    /// The values; as many as the product of the extents.
    pub values: Vec<f32>,
}

impl Tensor {
    /// The tensor as it is written to a file.
    pub fn view(&self) -> TensorView<'_> {
        TensorView {
            shape: &self.shape,
            values: Values::F32(&self.values),
        }
    }
}

/// A tensor that lies elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct TensorView<'a> {
    /// The extent of each dimension.
    pub shape: &'a [usize],
    /// The values; as many as the product of the extents.
    pub values: Values<'a>,
}

/// Numbers of the types that are written.
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// Real numbers, written as F32.
    F32(&'a [f32]),
    /// Whole numbers, written as I64.
    I64(&'a [i64]),
}

impl Values<'_> {
    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::I64(values) => values.len(),
        }
    }

    /// How many bytes they take in files.
    pub(crate) fn size(&self) -> usize {
        match self {
            Self::F32(values) => size_of_val(*values),
            Self::I64(values) => size_of_val(*values),
        }
    }

    /// The type's name in safetensors files.
    pub(crate) fn dtype(&self) -> &'static str {
        match self {
            Self::F32(_) => "F32",
            Self::I64(_) => "I64",
        }
    }

    /// The numbers as they lie in files.
    pub fn bytes(&self) -> Vec<u8> {
        match self {
            // Little-endian on every machine, as the format asks.
            Self::F32(values) => {
                let bytes: Vec<[u8; 4]> = values.iter().map(|value| value.to_le_bytes()).collect();
                bytes.into_flattened()
            }
            Self::I64(values) => {
                let bytes: Vec<[u8; 8]> = values.iter().map(|value| value.to_le_bytes()).collect();
                bytes.into_flattened()
            }
        }
    }
}
