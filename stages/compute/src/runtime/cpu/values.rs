//! Weights as kernels read them: a window at a time, widened to `f32` on the way.

use std::ops::Range;

use rayon::prelude::*;

use super::buffer::HostBuffer;
use super::chunks::{CHUNK, fill};
use super::simd::{prefetch, vectorize};
use crate::runtime::format::Format;

/// The numbers of one weight.
#[derive(Clone, Copy)]
pub enum Values<'a> {
    /// Numbers that are used where they lie.
    F32(&'a [f32]),
    /// Little-endian `f32` that may lie at any address.
    Bytes(&'a [[u8; 4]]),
    F16(&'a [[u8; 2]]),
    Bf16(&'a [[u8; 2]]),
}

impl<'a> Values<'a> {
    pub fn new(format: Format, bytes: &'a [u8]) -> Self {
        match format {
            // As bytes, since a mapped tensor may lie at any address.
            Format::F32 => Values::Bytes(bytes.as_chunks().0),
            Format::F16 => Values::F16(bytes.as_chunks().0),
            Format::Bf16 => Values::Bf16(bytes.as_chunks().0),
        }
    }

    pub fn len(self) -> usize {
        match self {
            Values::F32(values) => values.len(),
            Values::Bytes(bytes) => bytes.len(),
            Values::F16(bytes) | Values::Bf16(bytes) => bytes.len(),
        }
    }

    /// The values of `range`, as they are stored.
    pub fn slice(self, range: Range<usize>) -> Self {
        match self {
            Values::F32(values) => Values::F32(&values[range]),
            Values::Bytes(bytes) => Values::Bytes(&bytes[range]),
            Values::F16(bytes) => Values::F16(&bytes[range]),
            Values::Bf16(bytes) => Values::Bf16(&bytes[range]),
        }
    }

    /// Widens as many values as `out` has room for, from element `first` on.
    pub fn widen(self, first: usize, out: &mut [f32]) {
        match self.slice(first..first + out.len()) {
            Values::F32(values) => out.copy_from_slice(values),
            Values::Bytes(bytes) => convert(bytes, out, f32::from_le_bytes),
            Values::F16(bytes) => convert(bytes, out, |bytes| from_f16(u16::from_le_bytes(bytes))),
            Values::Bf16(bytes) => convert(bytes, out, |bytes| {
                f32::from_bits(u32::from(u16::from_le_bytes(bytes)) << 16)
            }),
        }
    }

    /// Asks for the values of `range`, if there are such, which will soon be read.
    pub fn prefetch(self, range: Range<usize>) {
        if range.end > self.len() {
            return;
        }
        match self.slice(range) {
            Values::F32(values) => prefetch(values),
            Values::Bytes(bytes) => prefetch(bytes),
            Values::F16(bytes) | Values::Bf16(bytes) => prefetch(bytes),
        }
    }

    pub fn to_buffer(self) -> HostBuffer {
        let mut out = HostBuffer::uninitialised(self.len());
        fill(&mut out, CHUNK, |i, out| self.widen(i * CHUNK, out));
        out
    }

    pub fn first_not_finite(self) -> Option<(usize, f32)> {
        (0..self.len().div_ceil(CHUNK))
            .into_par_iter()
            // The first in the file, whichever thread finds one first: the message must be the
            // same.
            .find_map_first(|chunk| {
                let first = chunk * CHUNK;
                let mut values = vec![0.0; CHUNK.min(self.len() - first)];
                self.widen(first, &mut values);
                let found = values.iter().position(|value| !value.is_finite())?;
                Some((first + found, values[found]))
            })
    }
}

#[inline(always)]
fn convert<const N: usize>(bytes: &[[u8; N]], out: &mut [f32], read: impl Fn([u8; N]) -> f32) {
    vectorize(
        #[inline(always)]
        || {
            for (out, bytes) in out.iter_mut().zip(bytes) {
                *out = read(*bytes);
            }
        },
    );
}

/// An IEEE half without a branch: its exponent and fraction, moved to where an `f32` keeps them,
/// are too small by the difference of the biases, 2^112, be it normal or not; only infinities and
/// NaN need their exponent filled.
#[inline(always)]
fn from_f16(bits: u16) -> f32 {
    let sign = u32::from(bits & 0x8000) << 16;
    let magnitude = u32::from(bits & 0x7fff) << 13;
    let scaled = (f32::from_bits(magnitude) * f32::from_bits((127 + 112) << 23)).to_bits();
    let special = if magnitude >= 0x7c00 << 13 {
        0x7f80_0000
    } else {
        0
    };
    f32::from_bits(sign | scaled | special)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_half_widens_to_its_value() {
        let all: Vec<u8> = (0..=u16::MAX).flat_map(u16::to_le_bytes).collect();
        for (bits, got) in Values::new(Format::F16, &all)
            .to_buffer()
            .iter()
            .copied()
            .enumerate()
        {
            let exponent = bits >> 10 & 31;
            let fraction = (bits & 1023) as f64 / 1024.0;
            let magnitude = match exponent {
                0 => fraction * 2f64.powi(-14),
                31 if fraction == 0.0 => f64::INFINITY,
                31 => f64::NAN,
                _ => (1.0 + fraction) * 2f64.powi(exponent as i32 - 15),
            };
            let expected = magnitude.copysign(if bits < 0x8000 { 1.0 } else { -1.0 });
            let same =
                f64::from(got) == expected && got.is_sign_negative() == expected.is_sign_negative();
            assert!(
                same || got.is_nan() && expected.is_nan(),
                "{bits:#06x} is {got}, expected {expected}"
            );
        }
    }

    #[test]
    fn a_number_that_is_none_is_found() {
        let mut bytes: Vec<u8> = [1.5f32; 40_000]
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        assert_eq!(Values::new(Format::F32, &bytes).first_not_finite(), None);
        bytes[4 * 33_333..][..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert_eq!(
            Values::new(Format::F32, &bytes).first_not_finite(),
            Some((33_333, f32::INFINITY))
        );
    }
}
