//! The x4 upscaler in one file beside the folder that diffusers makes of it: `../golden/single_file.py`
//! wrote which of its tensors becomes which, and what diffusers computes by them.

mod refusals;
mod tensors;
mod written;

use std::collections::BTreeMap;

use compute::{Array, Device};
use diffusion::unet::Input;
use diffusion::{ModelSource, Prior};
use serde_json::{Value, json};

use crate::support::{Golden, numbers};
use written::{Format, single, write_folder, write_single};

const TOLERANCE: f64 = 1e-5;

fn load(source: &ModelSource) -> Prior {
    Prior::load(source, &Device::cpu()).unwrap()
}

/// One step of the UNet, the autoencoder both ways, and two prompts.
fn asked(prior: &Prior) -> BTreeMap<&'static str, Array> {
    let sample = numbers(10, &[2, 7, 16, 8]);
    let input = Input {
        sample: &sample,
        timesteps: &[981, 37],
        class_labels: &[20, 3],
        lora: None,
        camera: None,
    };
    let text = prior.unet.text(&numbers(11, &[2, 9, 128]));
    let posterior = prior.vae.encode(&numbers(30, &[1, 3, 40, 32]));
    BTreeMap::from([
        ("unet.out", prior.unet.forward(&input, &text)),
        ("vae.mean", posterior.mean),
        ("vae.logvar", posterior.logvar),
        (
            "vae.decoded",
            prior.vae.decode(&numbers(31, &[1, 4, 10, 8])),
        ),
        (
            "text.states",
            prior.text(&["high resolution, 4K, photo", ""]),
        ),
    ])
}

fn bits(answers: &BTreeMap<&'static str, Array>) -> BTreeMap<&'static str, Vec<u32>> {
    let bits = |array: &Array| array.to_vec().into_iter().map(f32::to_bits).collect();
    answers.iter().map(|(name, a)| (*name, bits(a))).collect()
}

#[test]
fn a_single_file_computes_what_diffusers_does_and_the_bits_of_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let prior = load(&write_single(&place("single"), &single(), Format::F32));
    let answers = asked(&prior);
    let golden = Golden::read("single_file.safetensors");
    for (name, answer) in &answers {
        golden.assert(name, answer, TOLERANCE);
    }
    let of_folder = load(&write_folder(&place("folder")));
    assert!(bits(&answers) == bits(&asked(&of_folder)));
    let half = load(&write_single(&place("half"), &single(), Format::Bf16));
    assert!(bits(&answers) == bits(&asked(&half)));
    check_schedules(&prior, &of_folder);
}

/// What shapes do not tell is that of the folder, too.
fn check_schedules(single: &Prior, folder: &Prior) {
    for t in [0, 20, 350, 999] {
        assert_eq!(single.schedule.alpha_bar(t), folder.schedule.alpha_bar(t));
        assert_eq!(
            single.low_schedule.alpha_bar(t),
            folder.low_schedule.alpha_bar(t)
        );
    }
    let velocity = numbers(1, &[1, 2]);
    let noisy = numbers(2, &[1, 2]);
    assert_eq!(
        single.schedule.velocity(&velocity, &noisy, &[500]).to_vec(),
        velocity.to_vec(),
        "the UNet predicts velocities"
    );
    assert_eq!(single.max_noise_level, 350);
    assert_eq!(single.vae.scaling_factor(), 0.08333);
}

#[test]
fn its_digest_is_of_the_file_and_the_vocabulary_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let source = write_single(folder.path(), &single(), Format::Bf16);
    let digest = source.digest().unwrap();
    let names: Vec<String> = source
        .files()
        .unwrap()
        .iter()
        .map(|file| file.name().to_owned())
        .collect();
    let expected = ["merges.txt", "vocab.json", "x4.safetensors"]
        .map(|name| folder.path().join(name).display().to_string());
    assert_eq!(names, expected);
    let merges = folder.path().join("merges.txt");
    let text = std::fs::read_to_string(&merges).unwrap();
    std::fs::write(&merges, text + "x y\n").unwrap();
    assert_ne!(source.digest().unwrap(), digest);
}

#[test]
fn a_vocabulary_in_one_file_serves_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let source = write_single(folder.path(), &single(), Format::Bf16);
    let two = load(&source).tokenizer.encode("a photo");
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let vocabulary: Value = serde_json::from_str(&read("vocab.json")).unwrap();
    let text = read("merges.txt");
    let merges: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let page = json!({ "model": { "type": "BPE", "vocab": vocabulary, "merges": merges } });
    std::fs::write(folder.path().join("tokenizer.json"), page.to_string()).unwrap();
    for table in ["vocab.json", "merges.txt"] {
        std::fs::remove_file(folder.path().join(table)).unwrap();
    }
    let one = load(&source).tokenizer.encode("a photo");
    assert_eq!(one, two);
    assert_eq!(
        (one.len(), one[0], one[23]),
        (24, 766, 0),
        "OpenCLIP fills up with the id 0"
    );
}
