//! Tensors of a single file that are missing, of another shape or of no layer: each is named as the
//! file and as diffusers call it.

use super::refusals::{TEXT, UNET, VAE, hollow, refusal, said};
use super::written::{Format, Tensor, rows, write_single};

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
