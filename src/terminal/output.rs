//! Standard output and standard error: lines and tables. A reader that has gone away ends the
//! program quietly; a standard output that cannot be written, on a full disk say, is remembered
//! until the command has done its work.

use std::fmt::Display;
use std::io::{ErrorKind, Write, stderr, stdout};
use std::sync::OnceLock;

/// Why standard output lacks a line.
static LOST: OnceLock<std::io::Error> = OnceLock::new();

/// Prints one line on standard output.
pub fn print(line: &dyn Display) {
    match writeln!(stdout().lock(), "{line}") {
        // As `head` closes its input: that is no error, and nobody reads what would still come.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        // Only the first loss is told.
        Err(error) => drop(LOST.set(error)),
        Ok(()) => {}
    }
}

/// Whether standard output has every line that was printed; if not, why.
pub fn complete() -> Result<(), &'static std::io::Error> {
    LOST.get().map_or(Ok(()), Err)
}

/// Prints one line on standard error. Who closed it, or lets it lead to a full disk, cannot be told
/// so.
pub fn tell(line: &dyn Display) {
    let _ = writeln!(stderr().lock(), "{line}");
}

/// Prints JSON over several lines.
pub fn print_json(value: &serde_json::Value) {
    print(&format_args!("{value:#}"));
}

/// Rows of cells in aligned columns: the first to the left, the others to the right where `numbers`
/// says so.
pub fn table(rows: &[Vec<String>], numbers: bool) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter()
            .filter_map(|row| row.get(column))
            // In characters: an arrow or a `±` has several bytes, and takes one column.
            .map(|cell| cell.chars().count())
            .max()
    };
    let widths: Vec<usize> = (0..columns)
        .map(|column| width(column).unwrap_or(0))
        .collect();
    let cell = |(column, text): (usize, &String)| {
        if numbers && column > 0 {
            format!("{text:>0$}", widths[column])
        } else {
            format!("{text:0$}", widths[column])
        }
    };
    let line = |row: &Vec<String>| {
        row.iter()
            .enumerate()
            .map(cell)
            .collect::<Vec<_>>()
            .join("  ")
            .trim_end()
            .to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// A size as people say it.
pub fn size(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

/// Nested fields as one path and one text each: `params.guidance.lora_every`, `3`.
pub fn flatten(path: &str, value: &serde_json::Value) -> Vec<(String, String)> {
    match value {
        serde_json::Value::Object(fields) if !fields.is_empty() => fields
            .iter()
            .flat_map(|(name, value)| flatten(&format!("{path}.{name}"), value))
            .collect(),
        other => vec![(path.to_owned(), other.to_string())],
    }
}
