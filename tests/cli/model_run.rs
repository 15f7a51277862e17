//! `model run`: a network asked by files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::space::{Said, Space};
use crate::tensors::{Tensor, reals, save, shapes, wholes};

/// The folder of the prior that the program carries.
pub fn tiny_x4() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("stages/diffusion/models/tiny-x4")
}

pub fn inputs() -> BTreeMap<&'static str, Tensor> {
    BTreeMap::from([
        ("sample", reals(1, &[2, 19, 5, 6])),
        ("timestep", wholes(&[500, 20])),
        ("encoder_hidden_states", reals(2, &[2, 77, 32])),
        ("class_labels", wholes(&[20, 3])),
        ("target", reals(3, &[2, 16, 5, 6])),
    ])
}

/// Asks the UNet of tiny-x4 in a folder of its own.
pub fn ask(space: &Space, output: &str, more: &[&str]) -> Said {
    let model = tiny_x4();
    let input = space.path("in.safetensors");
    let output = space.path(output);
    let [model, input, output] = [&model, &input, &output].map(|path| path.to_str().unwrap());
    let asked = [
        "model", "run", model, "--part", "unet", "--input", input, "--output", output,
    ];
    space.say(&[&asked, more].concat())
}

#[test]
fn a_prompt_becomes_ids_and_states() {
    let space = Space::new();
    let model = tiny_x4();
    let output = space.path("text.safetensors");
    let files = [
        model.to_str().unwrap(),
        "--output",
        output.to_str().unwrap(),
    ];
    let said = space.say(
        &[
            &[
                "model", "run", "--part", "text", "--prompt", "a photo", "--repeat", "2", "--json",
            ],
            &files[..],
        ]
        .concat(),
    );
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(
        said.json()["forward_ms"].as_f64().unwrap() > 0.0
            && said.json()["forward_backward_ms"].is_null()
    );
    let expected = [
        ("input_ids".to_owned(), vec![1, 77]),
        ("last_hidden_state".to_owned(), vec![1, 77, 32]),
    ];
    assert_eq!(shapes(&output), BTreeMap::from(expected));
}

#[test]
fn what_a_network_cannot_be_asked_is_named_and_nothing_is_written() {
    let space = Space::new();
    let refused = |name: &'static str, tensor: Option<Tensor>, words: &str| {
        let mut tensors = inputs();
        tensors.remove(name);
        tensors.extend(tensor.map(|tensor| (name, tensor)));
        save(&space.path("in.safetensors"), &tensors);
        let said = ask(&space, "out.safetensors", &[]);
        assert_eq!(said.code, 3, "{}", said.err);
        let text = said.err.replace("\n  │ ", " ").replace('\n', " ");
        assert!(
            text.contains(&format!("`{name}`")) && text.contains(words),
            "{}",
            said.err
        );
        assert!(!space.path("out.safetensors").exists());
    };
    refused("sample", None, "is missing");
    refused(
        "sample",
        Some(reals(1, &[2, 7, 5, 6])),
        "expected [*, 19, *, *]",
    );
    refused("sample", Some(("F64", vec![1], vec![0; 8])), "is F64");
    refused(
        "sample",
        Some(("F32", vec![1], f32::NAN.to_le_bytes().to_vec())),
        "is NaN at element 0",
    );
    refused("timestep", Some(wholes(&[1, 2, 3])), "expected [2]");
    refused("timestep", Some(wholes(&[-1, 2])), "has the value -1");
    refused(
        "class_labels",
        Some(wholes(&[20, 1000])),
        "expected are 0 to 999",
    );
}
