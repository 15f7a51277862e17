//! Models that cannot be used: each gives one error that names the file and what in it is wrong.

use std::path::Path;

use compute::Device;
use diffusion::{ModelSource, Prior};
use safetensors::SafeTensors;
use serde_json::{Value, json};

/// What loading tiny-x4 says after `damage` was done to a copy of it.
fn refusal(damage: impl Fn(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    copy(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("models/tiny-x4"),
        folder.path(),
    );
    damage(folder.path());
    let prior = Prior::load(
        &ModelSource::Folder(folder.path().to_owned()),
        &Device::cpu(),
    );
    let message = prior.err().map(|e| e.to_string()).unwrap_or_default();
    message.replace(&format!("{}/", folder.path().display()), "")
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn set(folder: &Path, file: &str, field: &str, value: Value) {
    let path = folder.join(file);
    let mut config: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    config[field] = value;
    std::fs::write(path, config.to_string()).unwrap();
}

#[test]
fn an_undamaged_copy_is_not_refused() {
    assert_eq!(refusal(|_| {}), "");
}

#[test]
fn parts_that_do_not_fit_together_are_refused() {
    let set = |file: &'static str, field: &'static str, value: Value| {
        refusal(|folder| set(folder, file, field, value.clone()))
    };
    assert_eq!(
        set("unet/config.json", "in_channels", json!(7)),
        "unet/config.json: `in_channels` is 7; the autoencoder's latent channels and three colours ask for 19"
    );
    assert_eq!(
        set(
            "unet/config.json",
            "block_out_channels",
            json!([64, 96, 160])
        ),
        "unet/diffusion_pytorch_model.safetensors: tensor `down_blocks.2.resnets.0.time_emb_proj.bias` has the shape [128]; \
         the configuration asks for [160]"
    );
    assert_eq!(
        set("unet/config.json", "num_class_embeds", json!(null)),
        "unet/diffusion_pytorch_model.safetensors: tensor `class_embedding.weight` belongs to no layer of the configuration"
    );
    assert_eq!(
        set("model_index.json", "max_noise_level", json!(1000)),
        "model_index.json: `max_noise_level` is 1000; the low-resolution schedule and the UNet's `num_class_embeds` have \
         levels 0 to 999"
    );
    assert_eq!(
        set("vae/config.json", "layers_per_block", json!(2)),
        "vae/diffusion_pytorch_model.safetensors: tensor `encoder.down_blocks.0.resnets.1.norm1.weight` of shape [32] is missing"
    );
    assert_eq!(
        set(
            "scheduler/scheduler_config.json",
            "rescale_betas_zero_snr",
            json!(true)
        ),
        "scheduler/scheduler_config.json: `rescale_betas_zero_snr` is true; supported is false"
    );
    let vocabulary = set("text_encoder/config.json", "vocab_size", json!(700));
    assert_eq!(
        vocabulary,
        "tokenizer/vocab.json: has the id 767; the text encoder knows 700 ids"
    );
}

#[test]
fn damaged_files_are_refused() {
    let file = "unet/diffusion_pytorch_model.safetensors";
    for keep in [0, 5, 1000, 1 << 20] {
        let message = refusal(|folder| {
            let bytes = std::fs::read(folder.join(file)).unwrap();
            std::fs::write(folder.join(file), &bytes[..keep]).unwrap();
        });
        assert!(
            message.starts_with(&format!("{file}: is not a sound safetensors file: ")),
            "{keep}: {message}"
        );
    }
    let missing = refusal(|folder| std::fs::remove_file(folder.join("vae/config.json")).unwrap());
    assert!(
        missing.starts_with("vae/config.json: is missing; a model is a folder"),
        "{missing}"
    );
    let garbled =
        refusal(|folder| std::fs::write(folder.join("tokenizer/vocab.json"), "{").unwrap());
    assert!(
        garbled.starts_with("tokenizer/vocab.json: is not a JSON object of ids: "),
        "{garbled}"
    );
    let folder = refusal(|folder| {
        std::fs::remove_file(folder.join("tokenizer/merges.txt")).unwrap();
        std::fs::create_dir(folder.join("tokenizer/merges.txt")).unwrap();
    });
    assert_eq!(folder, "tokenizer/merges.txt: is not a file");
}

/// Splits the autoencoder's weights into two files and an index that says where each tensor lies;
/// `rename` names the files there.
fn shard(folder: &Path, rename: impl Fn(usize) -> String) {
    let stem = folder.join("vae/diffusion_pytorch_model.safetensors");
    let bytes = std::fs::read(&stem).unwrap();
    let mut tensors = SafeTensors::deserialize(&bytes).unwrap().tensors();
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let mut index = serde_json::Map::new();
    for (i, half) in tensors.chunks(tensors.len().div_ceil(2)).enumerate() {
        let views = half.iter().map(|(name, view)| (name.as_str(), view));
        let file = format!(
            "vae/diffusion_pytorch_model-{:05}-of-00002.safetensors",
            i + 1
        );
        std::fs::write(
            folder.join(file),
            safetensors::serialize(views, None).unwrap(),
        )
        .unwrap();
        index.extend(
            half.iter()
                .map(|(name, _)| (name.clone(), json!(rename(i + 1)))),
        );
    }
    let index = json!({ "metadata": {}, "weight_map": index }).to_string();
    std::fs::write(
        folder.join("vae/diffusion_pytorch_model.safetensors.index.json"),
        index,
    )
    .unwrap();
    std::fs::remove_file(stem).unwrap();
}

#[test]
fn shards_are_read_by_their_index() {
    let name = |i: usize| format!("diffusion_pytorch_model-{i:05}-of-00002.safetensors");
    assert_eq!(refusal(|folder| shard(folder, name)), "");
    let outside = refusal(|folder| shard(folder, |i| format!("../{}", name(i))));
    assert!(
        outside.contains("index.json: `weight_map` names \"../diffusion_pytorch_model-00001"),
        "{outside}"
    );
    let lost = refusal(|folder| {
        shard(folder, name);
        std::fs::remove_file(folder.join("vae").join(name(2))).unwrap();
    });
    assert!(
        lost.starts_with("vae/diffusion_pytorch_model-00002-of-00002.safetensors: is missing"),
        "{lost}"
    );
}
