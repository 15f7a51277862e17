//! `model`: a network asked by files, a model checked, and one got from a hub that stands in this
//! file.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::hub::Hub;
use crate::space::{Said, Space};

/// The folder of the prior that the program carries.
pub fn tiny_x4() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("stages/diffusion/models/tiny-x4")
}

/// A tensor's type, shape and bytes.
pub type Tensor = (&'static str, Vec<usize>, Vec<u8>);

/// Numbers in [-1, 1), others for each seed.
fn reals(seed: usize, shape: &[usize]) -> Tensor {
    let value = |i: usize| (((i + 1) * 7919 + seed * 104_729) % 1000) as f32 / 500.0 - 1.0;
    (
        "F32",
        shape.to_vec(),
        (0..shape.iter().product())
            .flat_map(|i| value(i).to_le_bytes())
            .collect(),
    )
}

fn wholes(values: &[i64]) -> Tensor {
    (
        "I64",
        vec![values.len()],
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
    )
}

pub fn save(path: &Path, tensors: &BTreeMap<&str, Tensor>) {
    let mut header = serde_json::Map::new();
    let mut data = Vec::new();
    for (name, (dtype, shape, bytes)) in tensors {
        let start = data.len();
        data.extend(bytes);
        header.insert(
            name.to_string(),
            json!({"dtype": dtype, "shape": shape, "data_offsets": [start, data.len()]}),
        );
    }
    let header = Value::Object(header).to_string().into_bytes();
    fs::write(
        path,
        [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat(),
    )
    .unwrap();
}

/// Names and shapes of a file's tensors.
fn shapes(path: &Path) -> BTreeMap<String, Vec<usize>> {
    let bytes = fs::read(path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    file.tensors()
        .into_iter()
        .map(|(name, view)| (name, view.shape().to_vec()))
        .collect()
}

const LORA: &str = "unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_q";

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
fn two_runs_and_any_number_of_threads_give_the_same_bytes() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let down = format!("{LORA}.lora_A.weight");
    let up = format!("{LORA}.lora_B.weight");
    let lora = BTreeMap::from([
        (&down[..], reals(4, &[3, 128])),
        (&up[..], reals(5, &[128, 3])),
    ]);
    save(&space.path("lora.safetensors"), &lora);
    let lora = space.path("lora.safetensors");
    for (output, threads, keep) in [("a", "1", "1024"), ("b", "2", "1024"), ("c", "2", "0")] {
        let more = [
            "--lora",
            lora.to_str().unwrap(),
            "--target-grad",
            "--threads",
            threads,
            "--keep",
            keep,
        ];
        let said = ask(&space, output, &more);
        assert_eq!((said.code, &said.out[..]), (0, ""), "{}", said.err);
    }
    let [a, b, c] = ["a", "b", "c"].map(|name| fs::read(space.path(name)).unwrap());
    assert!(a == b, "another number of threads, other bytes");
    assert!(a == c, "activations computed again, other bytes");
    assert_eq!(space.mode("a"), space.mode("in.safetensors"));
    let expected = [
        ("grad.sample".to_owned(), vec![2, 19, 5, 6]),
        (format!("grad.{down}"), vec![3, 128]),
        (format!("grad.{up}"), vec![128, 3]),
        ("loss".into(), vec![]),
        ("sample".into(), vec![2, 16, 5, 6]),
    ];
    assert_eq!(shapes(&space.path("a")), BTreeMap::from(expected));
}

#[test]
fn a_lora_under_kohyas_names_is_the_same_with_alpha_over_rank() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let [a, b] = [reals(4, &[3, 128]), reals(5, &[128, 3])];
    let twice = |(dtype, shape, bytes): &Tensor| {
        let values = bytes.as_chunks().0.iter();
        let doubled = values.flat_map(|four| (2.0 * f32::from_le_bytes(*four)).to_le_bytes());
        (*dtype, shape.clone(), doubled.collect::<Vec<u8>>())
    };
    let layer = LORA.trim_start_matches("unet.").replace('.', "_");
    let [down, up, alpha] = ["lora_down.weight", "lora_up.weight", "alpha"]
        .map(|part| format!("lora_unet_{layer}.{part}"));
    let six = ("F32", vec![], 6f32.to_le_bytes().to_vec());
    let kohya = BTreeMap::from([
        (&down[..], a.clone()),
        (&up[..], b.clone()),
        (&alpha[..], six),
    ]);
    save(&space.path("kohya.safetensors"), &kohya);
    let [down, up] = ["A", "B"].map(|matrix| format!("{LORA}.lora_{matrix}.weight"));
    save(
        &space.path("peft.safetensors"),
        &BTreeMap::from([(&down[..], a), (&up[..], twice(&b))]),
    );
    let [a, b] = ["kohya", "peft"].map(|name| {
        let lora = space.path(&format!("{name}.safetensors"));
        let said = ask(&space, name, &["--lora", lora.to_str().unwrap()]);
        assert_eq!(said.code, 0, "{}", said.err);
        fs::read(space.path(name)).unwrap()
    });
    assert!(a == b, "6 over a rank of 3 is 2, which scales exactly");
}

#[test]
fn alphas_for_patterns_of_layers_are_refused() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let [down, up] = ["A", "B"].map(|matrix| format!("{LORA}.lora_{matrix}.weight"));
    let lora = BTreeMap::from([
        (&down[..], reals(4, &[3, 128])),
        (&up[..], reals(5, &[128, 3])),
    ]);
    save(&space.path("lora.safetensors"), &lora);
    let ask = |pattern: &str| {
        let options = json!({"lora_alpha": 3, "alpha_pattern": {pattern: 6}});
        fs::write(space.path("adapter_config.json"), options.to_string()).unwrap();
        let lora = space.path("lora.safetensors");
        ask(&space, "out", &["--lora", lora.to_str().unwrap()])
    };
    assert_eq!(ask("attn1.to_q").code, 0);
    let said = ask(".*to_q");
    assert!(
        said.code == 3 && said.err.contains("alpha_pattern"),
        "{}",
        said.err
    );
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

#[test]
fn a_check_tells_parts_and_digests() {
    let space = Space::new();
    let said = space.say(&["model", "check", tiny_x4().to_str().unwrap(), "--json"]);
    assert_eq!(said.code, 0, "{}", said.err);
    let parts = said.json()["parts"].clone();
    let files = said.json()["files"].clone();
    let names: Vec<&str> = parts
        .as_array()
        .unwrap()
        .iter()
        .map(|part| part["part"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["unet", "vae", "text_encoder"]);
    assert_eq!(
        parts[0]["types"]
            .as_object()
            .unwrap()
            .keys()
            .collect::<Vec<_>>(),
        ["F16"]
    );
    assert_eq!(files.as_array().unwrap().len(), 13);
    assert!(
        files
            .as_array()
            .unwrap()
            .iter()
            .all(|file| file["sha256"].as_str().unwrap().len() == 64)
    );
}

#[test]
fn a_model_is_pulled_piece_by_piece_and_checked() {
    let space = Space::new();
    let hub = Hub::new(&tiny_x4());
    let pull = |hub: &Hub| {
        let home = space.path("home");
        let set = [
            ("HF_ENDPOINT", hub.url()),
            ("HF_HOME", home.to_str().unwrap().to_owned()),
        ];
        space.say_with(&set, &["model", "pull", "owner/tiny", "--json"])
    };
    hub.cut_off("unet/diffusion_pytorch_model.safetensors");
    let said = pull(&hub);
    assert!(
        said.code == 2
            && said
                .err
                .contains("unet/diffusion_pytorch_model.safetensors"),
        "{}",
        said.err
    );
    hub.serve_all();
    let said = pull(&hub);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(
        hub.resumed("unet/diffusion_pytorch_model.safetensors"),
        "the file was got from its beginning again"
    );
    let folder = said.json()["folder"].as_str().unwrap().to_owned();
    let checked = space.say(&["model", "check", &folder, "--json"]);
    assert_eq!(checked.code, 0, "{}", checked.err);
    // What is there is not got again, but it is checked again.
    let requests = hub.downloads();
    assert_eq!((pull(&hub).code, hub.downloads()), (0, requests));
    let weights = Path::new(&folder)
        .join("vae/diffusion_pytorch_model.safetensors")
        .canonicalize()
        .unwrap();
    let mut bytes = fs::read(&weights).unwrap();
    bytes[1000] ^= 1;
    fs::write(&weights, bytes).unwrap();
    let said = pull(&hub);
    assert!(
        said.code == 2 && said.err.contains("digest"),
        "{}",
        said.err
    );
    assert_eq!(pull(&hub).code, 0);
}

#[test]
fn a_name_that_is_none_is_refused_without_a_request() {
    let space = Space::new();
    for name in [
        "tiny",
        "a/b/c",
        "../tiny",
        "owner/a b",
        "owner/",
        "owner/..%2f",
    ] {
        let said = space.say(&["model", "pull", name]);
        assert!(
            said.code == 2 && said.err.contains("is no name of a model"),
            "{name}: {}",
            said.err
        );
    }
}
