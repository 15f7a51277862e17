//! A safetensors file as arrays and facts, and its real numbers widened to single precision. Whole
//! numbers and double precision are listed without a range. Knows nothing of models.

use std::collections::BTreeMap;
use std::path::Path;

use formats::{FileBytes, TensorFile};
use half::{bf16, f16};

use super::{Array, Content, range, read_whole, text_value};

/// What is in a file: its tensors with their ranges, and its metadata.
pub fn read(path: &Path) -> Result<Content, String> {
    let file = open(path)?;
    let mut content = Content::default();
    for name in file.names() {
        let entry = file.entry(name).map_err(|error| error.to_string())?;
        content.arrays.push(Array {
            name: name.to_owned(),
            shape: entry.shape().to_vec(),
            kind: entry.dtype(),
            range: widened(&file, name).and_then(|values| range(values.into_iter())),
        });
    }
    let metadata = file.metadata().iter();
    content.facts = metadata
        .map(|(name, text)| (name.clone(), text_value(text)))
        .collect();
    Ok(content)
}

/// The real numbers of a file, by the name of their tensor.
pub fn numbers(path: &Path) -> Result<BTreeMap<String, Vec<f32>>, String> {
    let file = open(path)?;
    Ok(file
        .names()
        .filter_map(|name| Some((name.to_owned(), widened(&file, name)?)))
        .collect())
}

/// The numbers of a tensor, if it is of F32, F16 or BF16. Single precision holds every half exactly.
fn widened(file: &TensorFile, name: &str) -> Option<Vec<f32>> {
    let entry = file.entry(name).ok()?;
    let bytes = &file.file()[entry.bytes()];
    let halves = || bytes.as_chunks().0.iter().copied();
    match entry.dtype().as_str() {
        "F32" => Some(entry.tensor(bytes).values),
        "F16" => Some(halves().map(|b| f16::from_le_bytes(b).to_f32()).collect()),
        "BF16" => Some(halves().map(|b| bf16::from_le_bytes(b).to_f32()).collect()),
        _ => None,
    }
}

fn open(path: &Path) -> Result<TensorFile, String> {
    // Read and not mapped: somebody may cut the file short meanwhile, which ends a process that has
    // it mapped.
    let file = FileBytes::in_memory(path.display().to_string(), read_whole(path)?);
    TensorFile::new(file).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_widened_and_whole_numbers_are_not_read() {
        let header = br#"{"a":{"dtype":"F16","shape":[2],"data_offsets":[0,4]},"b":{"dtype":"BF16","shape":[1],"data_offsets":[4,6]},"c":{"dtype":"U8","shape":[2],"data_offsets":[6,8]}}"#;
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(header);
        bytes.extend([0x00, 0x3e, 0x00, 0xc0, 0x20, 0x40, 1, 2]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("halves.safetensors");
        std::fs::write(&path, bytes).unwrap();

        let numbers = numbers(&path).unwrap();
        assert_eq!(numbers["a"], [1.5, -2.0]);
        assert_eq!(numbers["b"], [2.5]);
        assert!(!numbers.contains_key("c"));
        let row = read(&path).unwrap().arrays[0].row();
        assert_eq!(row, ["a", "2", "F16", "-2.000", "-0.2500", "1.500"]);
    }
}
