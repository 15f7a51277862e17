//! Weights out of one file and out of shards.

use super::*;
use crate::source::ModelSource;

/// Weights of files that each hold two F16 numbers under each of the names.
fn open(files: &[&[&str]]) -> Result<Weights, String> {
    let folder = tempfile::tempdir().unwrap();
    let source = ModelSource::Folder(folder.path().to_owned());
    let file = |(i, names): (usize, &&[&str])| {
        let entry = |(k, name): (usize, &&str)| {
            format!(
                r#""{name}":{{"dtype":"F16","shape":[2],"data_offsets":[{},{}]}}"#,
                4 * k,
                4 * k + 4
            )
        };
        let header = format!(
            "{{{}}}",
            names
                .iter()
                .enumerate()
                .map(entry)
                .collect::<Vec<_>>()
                .join(",")
        );
        let data = vec![0; 4 * names.len()];
        let bytes = [
            &(header.len() as u64).to_le_bytes(),
            header.as_bytes(),
            &data,
        ]
        .concat();
        std::fs::write(folder.path().join(format!("{i}.safetensors")), bytes).unwrap();
        source.file(&format!("{i}.safetensors")).unwrap()
    };
    let files = files.iter().enumerate().map(file).collect();
    Weights::open(files, &Device::cpu()).map_err(|e| e.to_string())
}

#[test]
fn shards_are_one_set_of_weights() {
    let weights = open(&[&["a.w"], &["a.b"]]).unwrap();
    let scope = weights.root().at("a");
    assert!(scope.has("w") && scope.has("b") && !scope.has("c"));
    scope.tensor("w", &[2]).unwrap();
    scope.tensor("b", &[2]).unwrap();
    weights.finish(&[]).unwrap();
    let twice = open(&[&["a"], &["b", "a"]]).err().unwrap();
    assert!(
        twice.contains("1.safetensors: tensor `a` is also in ") && twice.ends_with("0.safetensors"),
        "{twice}"
    );
}

#[test]
fn what_does_not_fit_is_named() {
    let weights = open(&[&["w"], &["v"]]).unwrap();
    let shape = weights.root().tensor("v", &[3]).unwrap_err().to_string();
    let expected = "1.safetensors: tensor `v` has the shape [2]; the configuration asks for [3]";
    assert!(shape.ends_with(expected), "{shape}");
    let missing = weights.root().tensor("b", &[4]).unwrap_err().to_string();
    assert!(
        missing.ends_with("tensor `b` of shape [4] is missing"),
        "{missing}"
    );
    let extra = weights.finish(&["w"]).unwrap_err().to_string();
    assert!(
        extra.ends_with("1.safetensors: tensor `v` belongs to no layer of the configuration"),
        "{extra}"
    );
}
