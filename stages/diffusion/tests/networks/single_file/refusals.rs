//! Single files that cannot be used: each gives one error that says what it is or lacks, and the
//! way out.

use std::path::Path;

use compute::Device;
use diffusion::{ModelSource, Prior};
use tempfile::TempDir;

use super::written::{Format, Row, Tensor, Tensors, rows, write_single};

const UNET: &str = "model.diffusion_model";
const VAE: &str = "first_stage_model";
const TEXT: &str = "cond_stage_model.model";

/// A model of which all numbers are 0, so that only names and shapes count.
fn hollow() -> Tensors {
    let empty = |(name, shape, _): Row| {
        let values = vec![0.0; shape.iter().product()];
        (name, Tensor { shape, values })
    };
    rows().into_iter().map(empty).collect()
}

/// What loading says after `damage` was done to the tensors and to the folder.
fn refusal(damage: impl Fn(&mut Tensors), folder_damage: impl Fn(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut tensors = hollow();
    damage(&mut tensors);
    let source = write_single(folder.path(), &tensors, Format::Bf16);
    folder_damage(folder.path());
    said(&folder, &source)
}

fn said(folder: &TempDir, source: &ModelSource) -> String {
    let prior = Prior::load(source, &Device::cpu());
    let message = prior.err().map(|e| e.to_string()).unwrap_or_default();
    message.replace(&format!("{}/", folder.path().display()), "")
}

fn without(name: &'static str) -> String {
    refusal(
        |tensors| {
            let gone: Vec<String> = tensors.keys().filter(|key| *key == name).cloned().collect();
            assert_eq!(gone, [name]);
            tensors.remove(name);
        },
        |_| {},
    )
}

#[test]
fn an_undamaged_file_is_not_refused() {
    assert_eq!(refusal(|_| {}, |_| {}), "");
}

#[test]
fn a_missing_tensor_is_named_as_the_file_and_as_diffusers_call_it() {
    let cases = [
        (
            "unet",
            "model.diffusion_model.label_emb.weight",
            "class_embedding.weight",
        ),
        (
            "unet",
            "model.diffusion_model.input_blocks.0.0.weight",
            "conv_in.weight",
        ),
        (
            "unet",
            "model.diffusion_model.input_blocks.1.0.in_layers.0.weight",
            "down_blocks.0.resnets.0.norm1.weight",
        ),
        (
            "unet",
            "model.diffusion_model.input_blocks.3.0.op.weight",
            "down_blocks.0.downsamplers.0.conv.weight",
        ),
        (
            "unet",
            "model.diffusion_model.input_blocks.7.1.proj_in.weight",
            "down_blocks.2.attentions.0.proj_in.weight",
        ),
        (
            "unet",
            "model.diffusion_model.output_blocks.8.2.conv.bias",
            "up_blocks.2.upsamplers.0.conv.bias",
        ),
        (
            "vae",
            "first_stage_model.decoder.up.0.block.1.conv2.weight",
            "decoder.up_blocks.2.resnets.1.conv2.weight",
        ),
        (
            "vae",
            "first_stage_model.encoder.mid.attn_1.proj_out.weight",
            "encoder.mid_block.attentions.0.to_out.0.weight",
        ),
        (
            "text_encoder",
            "cond_stage_model.model.transformer.resblocks.1.attn.in_proj_bias",
            "text_model.encoder.layers.1.self_attn.q_proj.bias",
        ),
        (
            "text_encoder",
            "cond_stage_model.model.token_embedding.weight",
            "text_model.embeddings.token_embedding.weight",
        ),
    ];
    for (folder, stored, name) in cases {
        assert_eq!(
            without(stored),
            format!(
                "x4.safetensors: tensor `{stored}` is missing, which is `{name}` in {folder}/ of diffusers; get the file anew, whole"
            )
        );
    }
}

/// One tensor of each kind, and some more: whatever is read is missed by its name, and what is not
/// read is not missed.
#[test]
fn no_tensor_goes_missing_unsaid() {
    let folder = tempfile::tempdir().unwrap();
    let all = hollow();
    for (stored, _, places) in rows().iter().step_by(37) {
        let mut tensors = all.clone();
        tensors.remove(stored);
        let source = write_single(folder.path(), &tensors, Format::Bf16);
        let said = said(&folder, &source);
        assert_eq!(
            said.starts_with(&format!("x4.safetensors: tensor `{stored}` is missing")),
            !places.is_empty(),
            "{stored}: {said}"
        );
    }
}

#[test]
fn a_tensor_of_another_shape_or_of_no_layer_is_named() {
    let reshaped = |name: String, shape: &'static [usize]| {
        refusal(
            |tensors| {
                let values = vec![0.0; shape.iter().product()];
                let shape = shape.to_vec();
                tensors.insert(name.clone(), Tensor { shape, values });
            },
            |_| {},
        )
    };
    assert_eq!(
        reshaped(
            format!("{TEXT}.transformer.resblocks.0.attn.in_proj_weight"),
            &[380, 128]
        ),
        "x4.safetensors: tensor `cond_stage_model.model.transformer.resblocks.0.attn.in_proj_weight` has the shape [380, 128]; \
         `text_model.encoder.layers.0.self_attn.q_proj.weight` in text_encoder/ of diffusers asks for [128, 128] in each of three parts"
    );
    assert_eq!(
        reshaped(
            format!("{VAE}.encoder.mid.attn_1.q.weight"),
            &[128, 64, 1, 1]
        ),
        "x4.safetensors: tensor `first_stage_model.encoder.mid.attn_1.q.weight` has the shape [128, 64, 1, 1]; \
         `encoder.mid_block.attentions.0.to_q.weight` in vae/ of diffusers asks for [128, 128]"
    );
    assert_eq!(
        reshaped(format!("{UNET}.label_emb.weight"), &[]),
        "x4.safetensors: tensor `model.diffusion_model.label_emb.weight` has the shape []; \
         `class_embedding.weight` in unet/ of diffusers asks for more axes"
    );
    assert_eq!(
        reshaped(format!("{UNET}.middle_block.3.weight"), &[1]),
        "x4.safetensors: tensor `model.diffusion_model.middle_block.3.weight` belongs to no layer of the configuration"
    );
    assert_eq!(
        reshaped(format!("{UNET}.out.2.weight"), &[5, 32, 3, 3]),
        "x4.safetensors, as unet/config.json: `out_channels` is 5; the autoencoder's latent channels ask for 4"
    );
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
