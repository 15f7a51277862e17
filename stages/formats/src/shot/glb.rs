//! The container of a binary glTF 2.0: JSON, then numbers. Knows neither.

use std::io::{self, Write};

// In little-endian bytes: "glTF", "JSON" and "BIN\0" (glTF 2.0, section 4.4).
const MAGIC: u32 = 0x4654_6C67;
const VERSION: u32 = 2;
const JSON: u32 = 0x4E4F_534A;
const BIN: u32 = 0x004E_4942;
/// The head of the file, and of each chunk.
const HEAD: usize = 12;
const CHUNK_HEAD: usize = 8;

/// Writes all up to the numbers, of which `length` bytes, whole words of 4, must follow.
///
/// # Errors
/// If `out` takes no more, or the file would have more bytes than its head can say.
pub fn head(mut json: String, length: usize, out: &mut dyn Write) -> io::Result<()> {
    // Chunks are whole words; JSON is filled up with spaces.
    let missing = json.len().next_multiple_of(4) - json.len();
    json.extend(std::iter::repeat_n(' ', missing));
    // The head has the length of all, so the JSON must be complete before the first byte.
    let whole = HEAD + CHUNK_HEAD + json.len() + CHUNK_HEAD + length;
    let too_large = |_| io::Error::other("a binary glTF holds at most 4 GiB");
    let whole = u32::try_from(whole).map_err(too_large)?;
    for word in [MAGIC, VERSION, whole, json.len() as u32, JSON] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(json.as_bytes())?;
    for word in [length as u32, BIN] {
        out.write_all(&word.to_le_bytes())?;
    }
    Ok(())
}
