//! What the shapes of the x4 upscaler's tensors do not tell, as its authors configured it
//! (`x4-upscaling.yaml` of Stability's `stablediffusion`) and as diffusers writes it down.
//!
//! The one place for it. A file of the same layout that was trained otherwise would be read
//! wrongly, and nothing in it would say so.

use serde_json::{Value, json};

/// The UNet: 8 heads in each attention, 32 groups in each normalisation, one transformer block in
/// each attention, and the timestep's cosines before its sines.
pub(super) fn unet() -> Value {
    json!({
        "attention_head_dim": 8, "norm_num_groups": 32, "norm_eps": 1e-5, "transformer_layers_per_block": 1,
        "use_linear_projection": true, "flip_sin_to_cos": true, "freq_shift": 0,
    })
}

/// Whether the first attention of a down block, and of the up block of its size, looks at the text
/// where its width could be either's: in all but the last.
pub(super) fn looks_at_text(block: usize, blocks: usize) -> bool {
    block + 1 < blocks
}

/// The autoencoder: latents are multiplied by 0.08333 before the UNet sees them.
pub(super) fn vae() -> Value {
    json!({ "scaling_factor": 0.08333, "norm_num_groups": 32 })
}

/// The text encoder, OpenCLIP's ViT-H: heads of 64 numbers, so that its 1024 make 16.
pub(super) fn text(width: usize) -> Value {
    json!({ "hidden_act": "gelu", "layer_norm_eps": 1e-5, "num_attention_heads": (width / 64).max(1) })
}

/// How many of the `stored` layers of a text encoder the states pass through: all but the last,
/// whose output only OpenCLIP's own training needs. Of ViT-H 23 in any case, since a file may have
/// lost the last.
pub(super) fn text_layers(width: usize, stored: usize) -> usize {
    match width {
        1024 => 23,
        _ => stored.saturating_sub(1),
    }
}

/// The noise schedule of latents. The UNet predicts velocities.
pub(super) fn scheduler() -> Value {
    schedule("v_prediction")
}

/// The noise schedule of the low-resolution image.
pub(super) fn low_res_scheduler() -> Value {
    schedule("epsilon")
}

fn schedule(prediction: &str) -> Value {
    json!({
        "beta_start": 1e-4, "beta_end": 0.02, "beta_schedule": "scaled_linear", "num_train_timesteps": 1000,
        "prediction_type": prediction,
    })
}

/// The low-resolution image was noised up to timestep 350 in training.
pub(super) fn pipeline() -> Value {
    json!({ "max_noise_level": 350 })
}

/// OpenCLIP fills short texts with the id 0, which is `!` in CLIP's vocabulary; CLIP itself with
/// the text's end.
pub(super) fn special_tokens() -> Value {
    json!({
        "bos_token": "<|startoftext|>", "eos_token": "<|endoftext|>", "unk_token": "<|endoftext|>", "pad_token": "!",
    })
}
