//! The files of `tiny-x4`, which the program carries.

macro_rules! embedded {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_bytes!(concat!("../../models/tiny-x4/", $name)).as_slice())),*]
    };
}

/// The files of tiny-x4: names below the model's folder, and contents.
pub(super) const EMBEDDED: &[(&str, &[u8])] = embedded![
    "low_res_scheduler/scheduler_config.json",
    "model_index.json",
    "scheduler/scheduler_config.json",
    "text_encoder/config.json",
    "text_encoder/model.safetensors",
    "tokenizer/merges.txt",
    "tokenizer/special_tokens_map.json",
    "tokenizer/tokenizer_config.json",
    "tokenizer/vocab.json",
    "unet/config.json",
    "unet/diffusion_pytorch_model.safetensors",
    "vae/config.json",
    "vae/diffusion_pytorch_model.safetensors",
];
