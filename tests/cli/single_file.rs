//! `model: File(..)`: the x4 upscaler in one file, wherever a model's folder is taken.

use std::collections::BTreeMap;
use std::fs;

use crate::model_run::tiny_x4;
use crate::space::Space;
use crate::tensors::{Tensor, save};

/// Names and shapes of a small single file, and what diffusers makes of each.
const ROWS: &str = include_str!("../../stages/diffusion/tests/golden/single_file.json");

const PIPELINE: &str = r#"(
    name: "tiny",
    stages: {
        "scene": Scene(source: Procedural(views: 3, size: (32, 24), samples: 1), downscale: 2, holdout: 2),
        "encode": Encode(images: "scene.train", model: File("x4.safetensors")),
    },
)"#;

/// A single file all of whose numbers are 0, and the vocabulary of tiny-x4 beside it.
fn space() -> Space {
    let space = Space::new();
    let rows: Vec<(String, Vec<usize>, serde_json::Value)> = serde_json::from_str(ROWS).unwrap();
    let zeros = |shape: &Vec<usize>| -> Tensor {
        let bytes = vec![0; 2 * shape.iter().product::<usize>()];
        ("BF16", shape.clone(), bytes)
    };
    let tensors: BTreeMap<&str, Tensor> = rows
        .iter()
        .map(|(name, shape, _)| (name.as_str(), zeros(shape)))
        .collect();
    save(&space.path("x4.safetensors"), &tensors);
    for table in ["vocab.json", "merges.txt"] {
        let from = tiny_x4().join("tokenizer").join(table);
        fs::copy(from, space.path(table)).unwrap();
    }
    fs::write(space.path("tiny.ron"), PIPELINE).unwrap();
    space
}

#[test]
fn a_check_tells_its_parts_and_the_files_that_it_consists_of() {
    let said = space().ok(&["model", "check", "x4.safetensors", "--json"]);
    let page = said.json();
    let parts: Vec<(&str, u64)> = page["parts"]
        .as_array()
        .unwrap()
        .iter()
        .map(|part| {
            let count = part["tensors"].as_u64().unwrap();
            (part["part"].as_str().unwrap(), count)
        })
        .collect();
    assert_eq!(parts, [("unet", 687), ("vae", 204), ("text_encoder", 28)]);
    assert_eq!(
        page["parts"][0]["configuration"],
        "7 to 4 channels, blocks of [32, 64, 64, 128]"
    );
    let files: Vec<&str> = page["files"]
        .as_array()
        .unwrap()
        .iter()
        .map(|file| file["file"].as_str().unwrap())
        .collect();
    assert_eq!(files, ["merges.txt", "vocab.json", "x4.safetensors"]);
}

#[test]
fn its_text_encoder_is_asked_and_a_stage_encodes_by_it() {
    let space = space();
    let asked = ["model", "run", "x4.safetensors", "--part", "text"];
    let about = ["--prompt", "a photo", "--output", "text.safetensors"];
    let said = space.ok(&[&asked[..], &about, &["--json"]].concat());
    let shapes = &said.json()["tensors"];
    assert_eq!(
        shapes["last_hidden_state"],
        serde_json::json!([1, 24, 128]),
        "{shapes}"
    );
    space.ok(&["run", "tiny.ron"]);
    let again = space.ok(&["run", "tiny.ron", "--json"]).last();
    assert_eq!(again["cached"], serde_json::json!(["encode", "scene"]));
}

#[test]
fn what_is_no_such_file_is_refused_before_anything_is_computed() {
    let space = space();
    let refused = |words: &[&str]| {
        let said = space.say(&["run", "tiny.ron"]);
        let text = said.err.replace("\n  │ ", " ").replace('\n', " ");
        assert_eq!(said.code, 3, "{}", said.err);
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert!(!space.path("out").exists());
    };
    fs::remove_file(space.path("vocab.json")).unwrap();
    refused(&["encode", "vocab.json: is missing", "carries no vocabulary"]);
    fs::write(space.path("x4.safetensors"), b"PK\x03\x04").unwrap();
    refused(&["encode", "is a pickle", "torch.load"]);
    fs::rename(space.path("x4.safetensors"), space.path("x4.ckpt")).unwrap();
    refused(&["encode", "x4.safetensors: is missing"]);
    let said = space.say(&["model", "check", "x4.ckpt"]);
    assert!(
        said.code == 3 && said.err.contains("x4.ckpt: is a pickle"),
        "{}",
        said.err
    );
}
