//! How the numbers of a weight are stored, and how precisely they are multiplied. It knows no
//! weight.

/// How the bytes of a weight encode numbers; all are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// IEEE 754 binary32.
    F32,
    /// IEEE 754 binary16.
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

/// How products with a weight are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// In `f32`.
    #[default]
    F32,
    /// Both factors rounded to bf16, their products summed in `f32`: an error of about 2e-3 of the
    /// result's norm. With AVX-512 BF16 that is the processor's dot product; elsewhere it is as
    /// exact, and no faster than `f32`. 3x3 convolutions that Winograd's filtering suits stay in
    /// `f32`, which is faster still.
    Bf16,
}
