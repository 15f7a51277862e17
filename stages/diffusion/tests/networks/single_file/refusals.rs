//! Single files that cannot be used: each gives one error that says what it is or lacks, and the
//! way out.

use std::path::Path;

use compute::Device;
use diffusion::{ModelSource, Prior};
use tempfile::TempDir;

use super::written::{Format, Row, Tensor, Tensors, rows, write_single};

pub const UNET: &str = "model.diffusion_model";
pub const VAE: &str = "first_stage_model";
pub const TEXT: &str = "cond_stage_model.model";

/// A model of which all numbers are 0, so that only names and shapes count.
pub fn hollow() -> Tensors {
    let empty = |(name, shape, _): Row| {
        let values = vec![0.0; shape.iter().product()];
        (name, Tensor { shape, values })
    };
    rows().into_iter().map(empty).collect()
}

/// What loading says after `damage` was done to the tensors and to the folder.
pub fn refusal(damage: impl Fn(&mut Tensors), folder_damage: impl Fn(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut tensors = hollow();
    damage(&mut tensors);
    let source = write_single(folder.path(), &tensors, Format::Bf16);
    folder_damage(folder.path());
    said(&folder, &source)
}

pub fn said(folder: &TempDir, source: &ModelSource) -> String {
    let prior = Prior::load(source, &Device::cpu());
    let message = prior.err().map(|e| e.to_string()).unwrap_or_default();
    message.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn an_undamaged_file_is_not_refused() {
    assert_eq!(refusal(|_| {}, |_| {}), "");
}

/// The first convolution for so many channels.
fn taking(channels: usize) -> String {
    refusal(
        |tensors| {
            let shape = vec![32, channels, 3, 3];
            let values = vec![0.0; 32 * channels * 9];
            let name = format!("{UNET}.input_blocks.0.0.weight");
            tensors.insert(name, Tensor { shape, values });
        },
        |_| {},
    )
}

/// With all names that begin with `from` beginning with `to`.
fn renamed(from: &'static str, to: &'static str) -> String {
    let rename = |name: &str| {
        name.strip_prefix(from)
            .map_or(name.to_owned(), |rest| format!("{to}{rest}"))
    };
    refusal(
        |tensors| {
            let all = std::mem::take(tensors).into_iter();
            *tensors = all.map(|(name, tensor)| (rename(&name), tensor)).collect();
        },
        |_| {},
    )
}

#[test]
fn another_model_is_refused_by_what_it_is_and_what_tells() {
    let expected = "; expected the Stable Diffusion x4 upscaler, x4-upscaler-ema.safetensors";
    let is = |message: String, words: &str| {
        assert_eq!(message, format!("x4.safetensors: is {words}{expected}"));
    };
    let channels = "its UNet takes";
    let wanted = "channels, the upscaler's 7: a latent's 4 and three colours";
    is(
        renamed(TEXT, "cond_stage_model.transformer.text_model"),
        "Stable Diffusion 1: its text encoder is CLIP's, `cond_stage_model.transformer.*`, the upscaler's is OpenCLIP's, \
         `cond_stage_model.model.*`",
    );
    is(
        renamed(TEXT, "conditioner.embedders.1.model"),
        "Stable Diffusion XL: its text encoders are `conditioner.embedders.*`, the upscaler's is `cond_stage_model.model.*`",
    );
    let models = [
        (4, "Stable Diffusion 2 for text to image"),
        (5, "Stable Diffusion 2 with depth"),
        (9, "Stable Diffusion 2 for inpainting"),
        (12, "another model of latent diffusion"),
    ];
    for (taken, model) in models {
        is(
            taking(taken),
            &format!("{model}: {channels} {taken} {wanted}"),
        );
    }
    is(
        renamed(UNET, "net"),
        "no model of latent diffusion: it has no `model.diffusion_model.*`, its first tensor is `betas`",
    );
    is(
        renamed(UNET, "down_blocks"),
        "a network out of a folder of diffusers: it has `down_blocks.*`; name the model's folder by `Folder(..)`",
    );
}

#[test]
fn a_file_without_vocabulary_is_refused_with_the_way_out() {
    let remove = |name: &'static str| {
        refusal(
            |_| {},
            |folder| std::fs::remove_file(folder.join(name)).unwrap(),
        )
    };
    let way_out = "put `vocab.json` and `merges.txt`, or `tokenizer.json`, of CLIP beside it: any Stable Diffusion has them in tokenizer/";
    for name in ["vocab.json", "merges.txt"] {
        assert_eq!(
            remove(name),
            format!("{name}: is missing, and x4.safetensors carries no vocabulary; {way_out}")
        );
    }
}

#[test]
fn the_vocabulary_of_another_model_is_refused() {
    let of = |words: usize| {
        refusal(
            |tensors| {
                let shape = vec![words, 128];
                let values = vec![0.0; words * 128];
                let name = format!("{TEXT}.token_embedding.weight");
                tensors.insert(name, Tensor { shape, values });
            },
            |_| {},
        )
    };
    assert_eq!(
        of(900),
        "vocab.json: has ids up to 767; the text encoder knows 900 ids: this is the vocabulary of another model"
    );
    assert_eq!(
        of(700),
        "vocab.json: has the id 767; the text encoder knows 700 ids"
    );
}

#[test]
fn pickles_folders_and_damage_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        said(&folder, &ModelSource::at(&path))
    };
    for (name, bytes) in [
        ("x4-upscaler-ema.ckpt", &b"\x80\x02}q"[..]),
        ("x4.safetensors", b"PK\x03\x04and more"),
    ] {
        let message = of(name, bytes);
        let expected = format!(
            "{name}: is a pickle, which can run any code when it is read; x4-upscaler-ema.safetensors lies beside it where it came from. \
             Where you trust it, convert it:\n    python3 -c 'import sys, torch"
        );
        assert!(message.starts_with(&expected), "{message}");
    }
    let short = of("short.safetensors", b"x");
    assert!(
        short.starts_with("short.safetensors: is not a sound safetensors file: "),
        "{short}"
    );
    std::fs::create_dir(folder.path().join("model")).unwrap();
    let swapped = [
        ModelSource::File(folder.path().join("model")),
        ModelSource::Folder(folder.path().join("short.safetensors")),
    ]
    .map(|source| said(&folder, &source));
    assert_eq!(
        swapped,
        [
            "model: is a folder; name a model's folder by `Folder(..)`",
            "short.safetensors: is a file; name a model in one file by `File(..)`"
        ]
    );
    let gone = said(
        &folder,
        &ModelSource::File(folder.path().join("gone.safetensors")),
    );
    assert_eq!(gone, "gone.safetensors: is missing");
}
