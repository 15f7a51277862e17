//! The networks beside diffusers, transformers and peft: `../golden/networks.py` wrote what those
//! compute.

use std::collections::BTreeMap;
use std::path::Path;

use crate::support::{Golden, golden, numbers};
use compute::elementwise::{scale, sub};
use compute::{Array, Device};
use diffusion::unet::Input;
use diffusion::{LoraNetwork, ModelSource, Prior, Unet};
use serde_json::{Value, json};

const TOLERANCE: f64 = 1e-5;

fn tiny() -> Prior {
    Prior::load(&ModelSource::Embedded, &Device::cpu()).unwrap()
}

#[test]
fn odd_prompts_have_the_ids_of_transformers() {
    let tokenizer = tiny().tokenizer;
    let rows: Vec<Value> =
        serde_json::from_slice(&std::fs::read(golden("tokens.json")).unwrap()).unwrap();
    assert!(rows.len() > 10);
    for row in rows {
        let expected: Vec<u32> = serde_json::from_value(row["ids"].clone()).unwrap();
        let text = row["text"].as_str().unwrap();
        assert_eq!(tokenizer.encode(text), expected, "{text:?}");
    }
}

#[test]
fn tiny_x4_computes_what_diffusers_does() {
    let prior = tiny();
    let golden = Golden::read("tiny.safetensors");
    let prompts = [
        "high resolution, 4K, photo",
        "blurry, low quality",
        "  Don't   SHOUT!!  it's\t42° & 1/2\n",
        "Ünïcödé: straße, ÅNGSTRÖM e\u{301} İstanbul",
    ];
    golden.assert("text.states", &prior.text(&prompts), TOLERANCE);
    golden.assert(
        "even.out",
        &forward(&prior.unet, [12, 16], [77, 32], 10),
        TOLERANCE,
    );
    golden.assert(
        "odd.out",
        &forward(&prior.unet, [11, 15], [77, 32], 20),
        TOLERANCE,
    );
    check_vae(&prior, &golden);
}

#[test]
fn gradients_of_tiny_x4_are_those_of_autograd() {
    let golden = Golden::read("tiny_lora.safetensors");
    check_training(&tiny().unet, &golden, [7, 10], [77, 32], (3, 6.0));
}

#[test]
fn a_model_of_another_shape_computes_what_diffusers_does() {
    let folder = tempfile::tempdir().unwrap();
    write_other(folder.path());
    let prior = Prior::load(
        &ModelSource::Folder(folder.path().to_owned()),
        &Device::cpu(),
    )
    .unwrap();
    let golden = Golden::read("other.safetensors");
    golden.assert(
        "text.states",
        &prior.text(&["high resolution, 4K, photo", "blurry, low quality"]),
        TOLERANCE,
    );
    golden.assert(
        "even.out",
        &forward(&prior.unet, [16, 8], [9, 40], 10),
        TOLERANCE,
    );
    golden.assert(
        "odd.out",
        &forward(&prior.unet, [13, 21], [9, 40], 20),
        TOLERANCE,
    );
    check_vae(&prior, &golden);
    check_training(&prior.unet, &golden, [6, 9], [9, 40], (2, 1.0));
}

fn labels(unet: &Unet) -> &'static [u32] {
    if unet.config().num_class_embeds.is_some() {
        &[20, 3]
    } else {
        &[]
    }
}

fn forward(unet: &Unet, [h, w]: [usize; 2], [s, d]: [usize; 2], stream: u64) -> Array {
    let sample = numbers(stream, &[2, unet.config().in_channels, h, w]);
    let input = Input {
        sample: &sample,
        timesteps: &[981, 37],
        class_labels: labels(unet),
        lora: None,
        camera: None,
    };
    unet.forward(&input, &unet.text(&numbers(stream + 1, &[2, s, d])))
}

fn check_vae(prior: &Prior, golden: &Golden) {
    let latent = prior.vae.config().latent_channels;
    let posterior = prior.vae.encode(&numbers(30, &[1, 3, 40, 32]));
    golden.assert("vae.mean", &posterior.mean, TOLERANCE);
    golden.assert("vae.logvar", &posterior.logvar, TOLERANCE);
    golden.assert(
        "vae.decoded",
        &prior.vae.decode(&numbers(31, &[1, latent, 10, 8])),
        TOLERANCE,
    );
}

/// The LoRA and camera embedding that the script trains.
fn lora(unet: &Unet, (rank, alpha): (usize, f64)) -> LoraNetwork {
    let fill = |tensors: &mut BTreeMap<String, Array>, first: u64| {
        for (stream, tensor) in (first..).zip(tensors.values_mut()) {
            *tensor = scale(&numbers(stream, tensor.shape()), 0.1);
        }
    };
    let mut lora = unet.new_lora(rank, alpha, 0);
    fill(&mut lora.adapters, 1000);
    fill(&mut lora.camera, 900);
    lora
}

fn check_training(
    unet: &Unet,
    golden: &Golden,
    [h, w]: [usize; 2],
    [s, d]: [usize; 2],
    size: (usize, f64),
) {
    let lora = lora(unet, size);
    let camera = numbers(42, &[2, 16]);
    let sample = numbers(40, &[2, unet.config().in_channels, h, w]);
    let text = unet.text(&numbers(41, &[2, s, d]));
    let class_labels = labels(unet);
    let input = Input {
        sample: &sample,
        timesteps: &[981, 37],
        class_labels,
        lora: Some(&lora),
        camera: Some(&camera),
    };
    let (y, tape) = unet.forward_train(&input, &text, usize::MAX);
    golden.assert("lora.out", &y, TOLERANCE);
    let dy = scale(&sub(&y, &numbers(43, y.shape())), 2.0 / y.len() as f32);
    let gradients = unet.backward(&input, &text, tape, &dy, true);
    golden.assert(
        "lora.grad.sample",
        gradients.sample.as_ref().unwrap(),
        TOLERANCE,
    );
    for name in golden.names("lora.grad.").filter(|name| *name != "sample") {
        let actual = gradients.adapters.get(name).or(gradients.camera.get(name));
        golden.assert(
            &format!("lora.grad.{name}"),
            actual.unwrap_or_else(|| panic!("no gradient {name}")),
            2e-5,
        );
    }
    assert!(
        gradients.adapters.keys().eq(lora.adapters.keys())
            && gradients.camera.keys().eq(lora.camera.keys())
    );
}

/// Writes the model that the script describes in `other.json`, with the weights that follow its
/// formula.
fn write_other(folder: &Path) {
    let other: Value =
        serde_json::from_slice(&std::fs::read(golden("other.json")).unwrap()).unwrap();
    let tiny = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/tiny-x4");
    for copied in [
        "tokenizer/vocab.json",
        "tokenizer/merges.txt",
        "scheduler/scheduler_config.json",
    ] {
        std::fs::create_dir_all(folder.join(copied).parent().unwrap()).unwrap();
        std::fs::copy(tiny.join(copied), folder.join(copied)).unwrap();
    }
    let files = [
        "unet/diffusion_pytorch_model",
        "vae/diffusion_pytorch_model",
        "text_encoder/model",
    ];
    for (first, stem) in [10_000, 20_000, 30_000].into_iter().zip(files) {
        let part = stem.split('/').next().unwrap();
        std::fs::create_dir_all(folder.join(part)).unwrap();
        std::fs::write(
            folder.join(part).join("config.json"),
            other["configs"][part].to_string(),
        )
        .unwrap();
        let shapes: BTreeMap<String, Vec<usize>> =
            serde_json::from_value(other["shapes"][part].clone()).unwrap();
        std::fs::write(
            folder.join(format!("{stem}.fp16.safetensors")),
            weights(&shapes, first),
        )
        .unwrap();
    }
}

/// A safetensors file of gains around 1, and of all else small enough for the next layer.
fn weights(shapes: &BTreeMap<String, Vec<usize>>, first: u64) -> Vec<u8> {
    let mut header = serde_json::Map::new();
    let mut data = Vec::new();
    for (stream, (name, shape)) in (first..).zip(shapes) {
        let (gain, offset) = match &shape[..] {
            [_] => (0.1, if name.ends_with("weight") { 1.0 } else { 0.0 }),
            [_, rest @ ..] => (
                (3.0 / rest.iter().product::<usize>() as f64).sqrt() as f32,
                0.0,
            ),
            [] => unreachable!("no scalars"),
        };
        let start = data.len();
        data.extend(
            numbers(stream, shape)
                .to_vec()
                .iter()
                .flat_map(|v| (gain * v + offset).to_le_bytes()),
        );
        header.insert(
            name.clone(),
            json!({ "dtype": "F32", "shape": shape, "data_offsets": [start, data.len()] }),
        );
    }
    let header = Value::Object(header).to_string().into_bytes();
    [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
}
