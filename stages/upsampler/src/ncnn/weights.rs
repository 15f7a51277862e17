//! The numbers of a `.bin` file, one array after the other. What may be compressed has a mark
//! before it.

use std::collections::BTreeMap;

use compute::{Array, Device, Format, Weight};
use formats::FileBytes;

use super::param::Layer;
use crate::error::UpsamplerError;

/// Marks of how an array is stored.
const F16: u32 = 0x0130_6B47;
const INT8: u32 = 0x000D_4B38;
const F32_MARKED: u32 = 0x0002_C056;

/// An open file, and how far it has been read.
pub struct Weights<'a> {
    file: &'a FileBytes,
    device: &'a Device,
    at: usize,
    types: BTreeMap<String, usize>,
    count: usize,
}

impl<'a> Weights<'a> {
    /// The arrays of a file.
    pub fn new(file: &'a FileBytes, device: &'a Device) -> Self {
        Self {
            file,
            device,
            at: 0,
            types: BTreeMap::new(),
            count: 0,
        }
    }

    /// The next array, which has a mark.
    pub fn marked(&mut self, layer: &Layer, shape: &[usize]) -> Result<Array, UpsamplerError> {
        let mark = self
            .file
            .get(self.at..)
            .and_then(|rest| rest.first_chunk::<4>());
        let mark = u32::from_le_bytes(*mark.ok_or_else(|| self.short(layer, shape))?);
        self.at += 4;
        match mark {
            // Mark 0 is ncnn's for plain numbers of 32 bits.
            0 => self.plain(layer, shape),
            F16 => {
                let array = self.numbers(layer, shape, Format::F16)?;
                // ncnn pads halves to whole words.
                self.at = self.at.next_multiple_of(4);
                Ok(array)
            }
            INT8 => Err(layer.wrong("has weights of 8 bits; supported are those of 16 and of 32")),
            F32_MARKED => Err(layer.wrong("has weights with scales; supported are plain ones of 16 and of 32 bits")),
            _ => Err(layer.wrong(format!(
                "has weights behind the mark {mark:#010x}, in a table perhaps; supported are plain ones of 16 and of 32 bits"
            ))),
        }
    }

    /// The next array, of 32 bits and without a mark.
    pub fn plain(&mut self, layer: &Layer, shape: &[usize]) -> Result<Array, UpsamplerError> {
        self.numbers(layer, shape, Format::F32)
    }

    /// Fails where numbers are left that no layer wanted.
    pub fn finish(self) -> Result<(BTreeMap<String, usize>, usize), UpsamplerError> {
        let left = self.file.len().saturating_sub(self.at);
        if left > 0 {
            let problem = format!(
                "has {left} bytes more than the layers of its .param take; the two do not belong together"
            );
            return Err(UpsamplerError::file(self.file.name(), problem));
        }
        Ok((self.types, self.count))
    }

    fn numbers(
        &mut self,
        layer: &Layer,
        shape: &[usize],
        format: Format,
    ) -> Result<Array, UpsamplerError> {
        // The shape is a foreign file's; a product that overflowed would seem to fit.
        let count = shape
            .iter()
            .try_fold(1usize, |product, &extent| product.checked_mul(extent));
        let end = count.and_then(|count| count.checked_mul(format.width())?.checked_add(self.at));
        let held = self.file.len();
        let (Some(count), Some(end)) = (count, end.filter(|&end| end <= held)) else {
            return Err(self.short(layer, shape));
        };
        let weight =
            Weight::from_bytes(self.device, shape, format, self.file.shared(), self.at..end);
        self.at = end;
        // One NaN would spread over the whole image, and nothing would say where it comes from.
        if let Some((index, value)) = weight.first_not_finite() {
            return Err(layer.wrong(format!("has the weight {value} at element {index}")));
        }
        self.count += 1;
        *self
            .types
            .entry(format!("{format:?}").to_uppercase())
            .or_default() += count;
        Ok(weight.to_array())
    }

    fn short(&self, layer: &Layer, shape: &[usize]) -> UpsamplerError {
        let name = self.file.name();
        let held = self.file.len();
        layer.wrong(format!(
            "needs weights of shape {shape:?} at byte {} of {name}, which has {held}",
            self.at
        ))
    }
}
