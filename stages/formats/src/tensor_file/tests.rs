//! Files of two numbers, sound and broken.

use std::collections::BTreeMap;

use super::*;
use crate::{TensorView, Values};

/// A file with this header and this data.
fn open(header: &str, data: &[u8]) -> Result<TensorFile, TensorError> {
    open_bytes(
        &[
            &(header.len() as u64).to_le_bytes(),
            header.as_bytes(),
            data,
        ]
        .concat(),
    )
}

fn open_bytes(bytes: &[u8]) -> Result<TensorFile, TensorError> {
    TensorFile::new(FileBytes::in_memory("w.safetensors", bytes.to_vec()))
}

fn pair(dtype: &str, data: &[u8]) -> TensorFile {
    open(
        &format!(
            r#"{{"a.w":{{"dtype":"{dtype}","shape":[2],"data_offsets":[0,{}]}}}}"#,
            data.len()
        ),
        data,
    )
    .unwrap()
}

#[test]
fn whole_numbers_have_two_widths() {
    assert_eq!(
        pair("I32", &[1, 0, 0, 0, 255, 255, 255, 255])
            .whole("a.w")
            .unwrap(),
        (vec![2], vec![1, -1])
    );
    let wide = [[7u8, 0, 0, 0, 0, 0, 0, 0], [255; 8]].concat();
    assert_eq!(
        pair("I64", &wide).whole("a.w").unwrap(),
        (vec![2], vec![7, -1])
    );
    let message = pair("F16", &[0; 4]).whole("a.w").unwrap_err().to_string();
    assert!(
        message.ends_with("tensor `a.w` is F16; supported are I64 and I32"),
        "{message}"
    );
}

#[test]
fn broken_headers_give_one_clear_error() {
    let huge = format!(
        r#"{{"w":{{"dtype":"F32","shape":[{}],"data_offsets":[0,4]}}}}"#,
        u64::MAX
    );
    let beyond = r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[0,16]}}"#;
    let hole = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#;
    let overlap = r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#;
    let backwards = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[8,4]}}"#;
    let results = [
        open_bytes(&[]),
        open_bytes(&[1, 2, 3]),
        open_bytes(&u64::MAX.to_le_bytes()),
        open_bytes(&[9, 0, 0, 0, 0, 0, 0, 0, b'{']),
        open("not json", &[]),
        open(&huge, &[0; 4]),
        open(beyond, &[0; 4]),
        open(hole, &[0; 8]),
        open(overlap, &[0; 8]),
        open(backwards, &[0; 8]),
    ];
    for (case, result) in results.into_iter().enumerate() {
        let message = result.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(
            message.contains("w.safetensors: is not a sound safetensors file: "),
            "case {case}: {message}"
        );
    }
}

#[test]
fn what_is_written_is_read_back() {
    let values = [1.5, f32::NAN, -0.0];
    let tensors = BTreeMap::from([
        (
            "b",
            TensorView {
                shape: &[3, 1],
                values: Values::F32(&values),
            },
        ),
        (
            "a",
            TensorView {
                shape: &[2],
                values: Values::I64(&[7, -1]),
            },
        ),
    ]);
    let metadata = BTreeMap::from([("format", "pt".to_owned())]);
    let bytes = to_bytes(&tensors, &metadata).unwrap();
    let file = open_bytes(&bytes).unwrap();
    assert_eq!(file.whole("a").unwrap(), (vec![2], vec![7, -1]));
    let real = file.tensor("b").unwrap();
    assert_eq!(real.shape, [3, 1]);
    assert_eq!(
        real.values.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
        values.map(f32::to_bits)
    );
    assert_eq!(file.metadata()["format"], "pt");
    assert_eq!(bytes.len() % 8, 4, "three floats behind a padded header");
}

#[test]
fn a_header_alone_says_what_the_whole_file_does() {
    let values = [1.5, 2.5];
    let view = TensorView {
        shape: &[2, 1],
        values: Values::F32(&values),
    };
    let metadata = BTreeMap::from([("format", "pt".to_owned())]);
    let whole = to_bytes(&BTreeMap::from([("a", view)]), &metadata).unwrap();
    let shapes = BTreeMap::from([("a", [2, 1].as_slice())]);
    let begin = header(&shapes, &metadata).unwrap();
    assert_eq!([&begin[..], &view.values.bytes()].concat(), whole);
    assert_eq!(BEGIN as u64 + header_bytes(&begin), begin.len() as u64);
    let index = |length| Index::new("w.safetensors", &begin, length);
    let known = index(whole.len() as u64).unwrap();
    let entry = known.reals("a").unwrap();
    assert_eq!(entry.tensor(&whole[entry.bytes()]).values, values);
    for length in [begin.len(), whole.len() - 1, whole.len() + 1] {
        let message = index(length as u64).unwrap_err().to_string();
        assert!(
            message.contains("is not a sound safetensors file"),
            "{message}"
        );
    }
}

#[test]
fn what_cannot_be_written_is_named() {
    let refused = |name: &str, shape: &[usize]| {
        let view = TensorView {
            shape,
            values: Values::F32(&[0.0]),
        };
        let tensors = BTreeMap::from([(name, view)]);
        to_bytes(&tensors, &BTreeMap::new())
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        refused("a", &[2]),
        "tensor \"a\": 1 values do not fill the shape [2]"
    );
    assert!(refused("a", &[usize::MAX, 2]).contains("do not fill"));
    assert!(refused("__metadata__", &[1]).contains("keeps for itself"));
}

#[test]
fn only_f32_is_taken_as_it_is() {
    let message = pair("F16", &[0; 4]).tensor("a.w").unwrap_err().to_string();
    assert_eq!(message, "w.safetensors: tensor `a.w` is F16; expected F32");
    let message = pair("F16", &[0; 4]).tensor("b").unwrap_err().to_string();
    assert_eq!(message, "w.safetensors: tensor `b` is missing");
}
