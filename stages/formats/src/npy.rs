//! Reads a two-dimensional NumPy `.npy` file of floats. Bounded: nothing is allocated that the
//! file's own length does not back. Knows nothing of what the numbers mean.
//!
//! Format: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// No table of camera poses comes near this many bytes (it is half a million LLFF rows).
const LARGEST_FILE: u64 = 64 << 20;
const MAGIC: &[u8] = b"\x93NUMPY";

/// Row-major values of a 2-D array.
#[derive(Debug, PartialEq)]
pub struct Table {
    /// Number of rows.
    pub rows: usize,
    /// How many values in each.
    pub columns: usize,
    /// All values, row by row.
    pub values: Vec<f64>,
}

/// Why a file is no table that can be used.
#[derive(Debug, thiserror::Error)]
pub enum NpyError {
    /// The file system said no.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The file is something else, or broken.
    #[error("{0}")]
    Content(String),
}

/// Reads a little-endian f64 or f32 array in C order.
///
/// # Errors
/// Files that are larger than any table of cameras, and what is no such array.
pub fn read_table(path: &Path) -> Result<Table, NpyError> {
    let mut bytes = Vec::new();
    let file = File::open(path)?;
    // One byte more tells a file of just that size from a longer one.
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(NpyError::Content("the file is over 64 MiB".into()));
    }
    parse(&bytes).map_err(NpyError::Content)
}

fn parse(bytes: &[u8]) -> Result<Table, String> {
    let (header, data) = split_header(bytes)?;
    let (rows, columns) = shape(field(header, "shape")?)?;
    // Taken for C order, the numbers of a pose would come from many rows.
    if field(header, "fortran_order")?.starts_with("True") {
        return Err("the array is in Fortran order".into());
    }
    let width = element_width(field(header, "descr")?)?;
    // The shape is a foreign file's: the product is checked, and must be just what follows.
    let needed = rows.checked_mul(columns).and_then(|n| n.checked_mul(width));
    if needed != Some(data.len()) {
        return Err(format!(
            "shape {rows}x{columns} does not fit the {} bytes of values that follow",
            data.len()
        ));
    }
    Ok(Table {
        rows,
        columns,
        values: data.chunks_exact(width).map(little_endian).collect(),
    })
}

/// The header's text and the values behind it.
fn split_header(bytes: &[u8]) -> Result<(&str, &[u8]), String> {
    let rest = bytes.strip_prefix(MAGIC).ok_or("this is not a .npy file")?;
    // Version 1 has a length of two bytes, later ones of four (NumPy's formats 1.0 and 2.0).
    let (length, rest) = match *rest {
        [1, _, a, b, ref rest @ ..] => (u32::from(u16::from_le_bytes([a, b])), rest),
        [2 | 3, _, a, b, c, d, ref rest @ ..] => (u32::from_le_bytes([a, b, c, d]), rest),
        _ => return Err("the header is cut short or of an unknown version".into()),
    };
    let (header, data) = rest
        .split_at_checked(length as usize)
        .ok_or("the header is cut short")?;
    Ok((
        str::from_utf8(header).map_err(|_| "the header is not text")?,
        data,
    ))
}

/// The text from a field's value on. The header is a Python dictionary literal that NumPy itself
/// writes.
fn field<'a>(header: &'a str, name: &str) -> Result<&'a str, String> {
    // No parser of Python: the names, as NumPy itself quotes them, are looked for in the text.
    let missing = || format!("the header has no '{name}'");
    let (_, after) = header
        .split_once(&format!("'{name}'"))
        .ok_or_else(missing)?;
    Ok(after
        .trim_start()
        .strip_prefix(':')
        .ok_or_else(missing)?
        .trim_start())
}

fn element_width(descr: &str) -> Result<usize, String> {
    // Big-endian and whole numbers are refused by name: LLFF writes neither.
    match descr.get(..5) {
        Some("'<f8'") => Ok(8),
        Some("'<f4'") => Ok(4),
        _ => {
            let shown: String = descr.chars().take_while(|c| *c != ',').take(20).collect();
            Err(format!("the values are of type {shown}"))
        }
    }
}

fn shape(text: &str) -> Result<(usize, usize), String> {
    let inside = text
        .strip_prefix('(')
        .and_then(|t| t.split_once(')'))
        .map(|(inside, _)| inside);
    let inside = inside.ok_or("the header's shape is not a tuple")?;
    let sizes: Option<Vec<usize>> = inside
        .split(',')
        .map(str::trim)
        // Python's tuples may end with a comma: (17,).
        .filter(|t| !t.is_empty())
        .map(|t| t.parse().ok())
        .collect();
    match sizes.as_deref() {
        Some(&[rows, columns]) => Ok((rows, columns)),
        _ => Err(format!(
            "the shape is ({})",
            inside.chars().take(60).collect::<String>()
        )),
    }
}

fn little_endian(bytes: &[u8]) -> f64 {
    match *bytes {
        [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
        [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
        // `chunks_exact` gives no other length.
        _ => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder;
    use proptest::prelude::*;

    /// Written by an independent library.
    fn written(shape: &[u64], values: &[f64]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = npyz::WriteOptions::new()
            .default_dtype()
            .shape(shape)
            .writer(&mut bytes)
            .begin_nd()
            .unwrap();
        writer.extend(values).unwrap();
        writer.finish().unwrap();
        bytes
    }

    fn with_header(header: &str, data: &[u8]) -> Vec<u8> {
        let length = (header.len() as u16).to_le_bytes();
        [MAGIC, &[1, 0], &length, header.as_bytes(), data].concat()
    }

    #[test]
    fn reads_what_an_independent_writer_wrote() {
        let values = [1.5, -2.0, 3.25e17, f64::MIN_POSITIVE, 0.0, -0.125];
        let table = parse(&written(&[2, 3], &values)).unwrap();
        assert_eq!(
            table,
            Table {
                rows: 2,
                columns: 3,
                values: values.to_vec()
            }
        );
    }

    #[test]
    fn reads_single_precision_and_headers_in_any_field_order() {
        let header = "{'shape': (1,2), 'fortran_order': False, 'descr': '<f4'}";
        let data = [1.5f32.to_le_bytes(), (-2.0f32).to_le_bytes()].concat();
        assert_eq!(
            parse(&with_header(header, &data)).unwrap().values,
            [1.5, -2.0]
        );
    }

    #[test]
    fn faults_are_named() {
        let fault = |header: &str, data: &[u8]| parse(&with_header(header, data)).unwrap_err();
        let c = "'fortran_order': False";
        assert_eq!(parse(b"PK\x03\x04").unwrap_err(), "this is not a .npy file");
        assert_eq!(
            parse(b"\x93NUMPY\x01\x00\x40").unwrap_err(),
            "the header is cut short or of an unknown version"
        );
        assert_eq!(
            parse(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{").unwrap_err(),
            "the header is cut short"
        );
        assert_eq!(
            fault(
                &format!("{{'descr': '<i8', {c}, 'shape': (1, 1)}}"),
                &[0; 8]
            ),
            "the values are of type '<i8'"
        );
        assert_eq!(
            fault(&format!("{{'descr': '<f8', {c}, 'shape': (4,)}}"), &[0; 32]),
            "the shape is (4,)"
        );
        assert_eq!(
            fault(&format!("{{'descr': '<f8', {c}}}"), &[]),
            "the header has no 'shape'"
        );
        assert_eq!(
            fault(
                "{'descr': '<f8', 'fortran_order': True, 'shape': (1, 1)}",
                &[0; 8]
            ),
            "the array is in Fortran order"
        );
        assert_eq!(
            fault(
                &format!("{{'descr': '<f8', {c}, 'shape': (20, 17)}}"),
                &[0; 100]
            ),
            "shape 20x17 does not fit the 100 bytes of values that follow"
        );
    }

    #[test]
    fn a_header_that_promises_more_than_memory_is_refused_before_any_allocation() {
        let huge = format!(
            "{{'descr': '<f8', 'fortran_order': False, 'shape': ({0}, {0})}}",
            u64::MAX
        );
        assert!(
            parse(&with_header(&huge, &[0; 8]))
                .unwrap_err()
                .contains("does not fit")
        );
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            damage in prop::collection::vec((0..400usize, any::<u8>()), 1..6),
            length in 0..400usize,
        ) {
            let mut bytes = written(&[2, 17], &[0.5; 34]);
            bytes.truncate(length.max(8));
            for (at, byte) in damage {
                if let Some(slot) = bytes.get_mut(at) {
                    *slot = byte;
                }
            }
            if let Ok(table) = parse(&bytes) {
                prop_assert_eq!(table.values.len(), table.rows * table.columns);
            }
        }

        #[test]
        fn arbitrary_headers_never_panic(header in "\\PC{0,80}", data in prop::collection::vec(any::<u8>(), 0..64)) {
            let _ = parse(&with_header(&header, &data));
            let _ = parse(&with_header(&format!("{{'descr': '<f8','fortran_order': F, 'shape': {header}"), &data));
        }
    }
}
