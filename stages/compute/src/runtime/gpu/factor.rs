//! Factors of products in device memory. They know how they are stored, not how they are read.

use super::pool::Buffer;
use crate::runtime::format::Format;

/// A factor in device memory.
#[derive(Clone, Copy)]
pub struct Factor<'a> {
    /// Where its numbers lie.
    pub numbers: &'a Buffer,
    /// How they are stored.
    pub format: Format,
}

impl<'a> From<&'a Buffer> for Factor<'a> {
    fn from(numbers: &'a Buffer) -> Factor<'a> {
        Factor {
            numbers,
            format: Format::F32,
        }
    }
}
