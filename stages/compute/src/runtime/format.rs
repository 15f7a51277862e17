//! How the numbers of a weight are stored, and how precisely they are multiplied. It knows no
//! weight.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the bytes of a weight encode numbers; all are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// IEEE 754 binary32, four bytes.
    F32,
    /// IEEE 754 binary16, two bytes.
    F16,
    /// The upper half of a binary32.
    Bf16,
}

impl Format {
    /// Bytes of one number.
    pub fn width(self) -> usize {
        match self {
            Format::F32 => 4,
            Format::F16 | Format::Bf16 => 2,
        }
    }
}

/// The number format of the factors in products with a weight; sums are always in `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Brain floats, the upper half of an `f32`: the error is some 2e-3 of a product's norm.
    // With AVX-512 BF16 it is the processor's dot product; elsewhere it is as exact, and no faster
    // than `f32`. 3x3 convolutions that Winograd's filtering suits stay in `f32`, which is faster
    // still.
    Bf16,
}
