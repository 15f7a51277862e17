//! A weight that lies in a file, under the name that the file has for its number type.

use std::ops::Range;

use super::device::Device;
use super::format::Format;
use super::weight::{SharedBytes, Weight};

/// Why a file's numbers are no weight.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum StoredFault {
    /// Numbers of a type that no operator takes.
    #[error("is {0}; supported are F32, F16 and BF16")]
    Type(String),
    /// A number that is none.
    #[error("is {value} at element {index}")]
    NotFinite {
        /// Which one, counted from 0.
        index: usize,
        /// The infinity or NaN.
        value: f32,
    },
}

impl Weight {
    /// [`Weight::from_bytes`] of numbers whose type is named as in safetensors files.
    ///
    /// # Errors
    /// Types other than F32, F16 and BF16, and numbers that are not finite.
    pub fn stored(
        device: &Device,
        shape: &[usize],
        dtype: &str,
        owner: SharedBytes,
        range: Range<usize>,
    ) -> Result<Weight, StoredFault> {
        let format = match dtype {
            "F32" => Format::F32,
            "F16" => Format::F16,
            "BF16" => Format::Bf16,
            other => return Err(StoredFault::Type(other.to_owned())),
        };
        let weight = Weight::from_bytes(device, shape, format, owner, range);
        // Looked through once, here: NaN in a weight would spread to all that it meets.
        match weight.first_not_finite() {
            Some((index, value)) => Err(StoredFault::NotFinite { index, value }),
            None => Ok(weight),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn stored(dtype: &str, data: &[u8]) -> Result<Vec<f32>, String> {
        let owner = Arc::new(data.to_vec());
        Weight::stored(&Device::cpu(), &[2], dtype, owner, 0..data.len())
            .map(|weight| weight.to_array().to_vec())
            .map_err(|fault| fault.to_string())
    }

    #[test]
    fn three_formats_are_widened() {
        let single = stored("F32", &[0, 0, 128, 63, 0, 0, 0, 192]);
        assert_eq!(single.unwrap(), [1.0, -2.0]);
        assert_eq!(stored("F16", &[0, 60, 0, 192]).unwrap(), [1.0, -2.0]);
        assert_eq!(stored("BF16", &[128, 63, 0, 192]).unwrap(), [1.0, -2.0]);
    }

    #[test]
    fn what_is_no_weight_says_why() {
        let says = |dtype, data: &[u8], text| assert_eq!(stored(dtype, data).unwrap_err(), text);
        let types = "is I16; supported are F32, F16 and BF16";
        says("I16", &[0, 60, 0, 192], types);
        says("F16", &[0, 60, 0, 0x7e], "is NaN at element 1");
        let infinite = [0, 0, 128, 127, 0, 0, 0, 0];
        says("F32", &infinite, "is inf at element 0");
    }
}
