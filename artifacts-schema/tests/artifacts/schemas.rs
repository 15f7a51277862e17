//! The JSON Schemas of the crate's folder `schemas` are those of its types, and describe what its
//! codecs write.
//!
//! `UPDATE=1 cargo test -p artifacts-schema schemas` rewrites them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use artifacts_schema::schemas;
use safetensors::SafeTensors;
use serde_json::Value;
use tempfile::tempdir;

use crate::samples;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("schemas")
        .join(format!("{name}.json"))
}

#[test]
fn the_files_are_those_of_the_types() {
    for (name, schema) in schemas::all() {
        let text = format!("{:#}\n", schema.to_value());
        if std::env::var_os("UPDATE").is_some() {
            std::fs::create_dir_all(file(name).parent().unwrap()).unwrap();
            std::fs::write(file(name), &text).unwrap();
        }
        let stored = std::fs::read_to_string(file(name)).unwrap();
        assert_eq!(
            stored, text,
            "schemas/{name}.json is out of date: run the tests with UPDATE=1"
        );
    }
}

/// All JSON that the samples' files hold, by schema.
fn written() -> Vec<(&'static str, Value)> {
    let root = tempdir().unwrap();
    samples::write_all(root.path(), &samples::provenance()).unwrap();
    let files = samples::files(root.path());
    let json = |text: &[u8]| serde_json::from_slice::<Value>(text).unwrap();
    let metadata = |file: &str| {
        let (_, header) = SafeTensors::read_metadata(&files[file]).unwrap();
        let metadata: BTreeMap<_, _> = header.metadata().clone().unwrap().into_iter().collect();
        json(metadata["srnerf"].as_bytes())
    };
    vec![
        ("field", metadata("field/field.safetensors")),
        ("latents", metadata("latents/latents.safetensors")),
        ("latents", metadata("residuals/residuals.safetensors")),
        (
            "log",
            json(
                files["log/log.jsonl"]
                    .split(|&byte| byte == b'\n')
                    .next()
                    .unwrap(),
            ),
        ),
        ("lora", metadata("lora/pytorch_lora_weights.safetensors")),
        ("lora", metadata("lora/camera_embedding.safetensors")),
        ("metrics", json(&files["metrics/metrics.json"])),
        ("provenance", json(&files["figures/provenance.json"])),
        ("transforms", json(&files["images/transforms.json"])),
    ]
}

fn is_valid(name: &str, value: &Value) -> bool {
    let schema = serde_json::from_slice(&std::fs::read(file(name)).unwrap()).unwrap();
    jsonschema::is_valid(&schema, value)
}

#[test]
fn what_is_written_is_valid() {
    let written = written();
    for (name, value) in &written {
        assert!(is_valid(name, value), "{name}: {value}");
    }
    let described: Vec<&str> = written.iter().map(|(name, _)| *name).collect();
    assert!(
        schemas::all()
            .iter()
            .all(|(name, _)| described.contains(name))
    );
}

#[test]
fn what_lacks_a_field_is_not() {
    for (name, mut value) in written() {
        let required = ["provenance", "srnerf", "key"]
            .iter()
            .find(|field| value.get(**field).is_some());
        if let Some(field) = required {
            value.as_object_mut().unwrap().remove(*field);
            assert!(!is_valid(name, &value), "{name} without {field}");
        }
    }
}
