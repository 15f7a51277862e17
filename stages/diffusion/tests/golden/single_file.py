"""A small x4 upscaler in the layout of latent diffusion's single file, and what diffusers makes of it.

python single_file.py MODEL_FOLDER [OUT], with the folder of tiny-x4, whose vocabulary it takes. Writes into the script's folder:
  single_file.json         each tensor's name and shape in the single file, and the names that diffusers' own conversion gives it
  single_file.safetensors  what diffusers and transformers compute by the converted weights
With OUT also both models themselves: OUT/x4.safetensors with its vocabulary beside it, and OUT/folder.

Names and shapes of the single file follow the constructors of latent diffusion's UNetModel, Encoder and Decoder and of OpenCLIP's text
transformer, for the sizes below; the converted weights must load without a tensor too many or too few. Weights follow a formula.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import torch
from diffusers import AutoencoderKL, DDIMScheduler, DDPMScheduler, UNet2DConditionModel
from diffusers.loaders.single_file_utils import convert_ldm_unet_checkpoint, convert_ldm_vae_checkpoint, convert_open_clip_checkpoint
from networks import HERE, numbers, unet_case, vae_case
from safetensors.torch import save_file
from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

UNET, VAE, TEXT = "model.diffusion_model.", "first_stage_model.", "cond_stage_model.model."
# The x4 upscaler's, but for base channels of 256, 128 channels in the autoencoder, and a text encoder of 24 layers of 1024.
BASE, MULTIPLES, RESNETS, CLASSES = 32, [1, 2, 2, 4], 2, 400
VAE_BASE, VAE_MULTIPLES, LATENT = 32, [1, 2, 4], 4
WIDTH, LAYERS, WORDS, LENGTH = 128, 3, 768, 24


def affine(outputs, *inputs):
    return {"weight": (outputs, *inputs), "bias": (outputs,)}


def put(tensors, place, layer):
    tensors.update({f"{place}.{name}": shape for name, shape in layer.items()})


def unet_resnet(tensors, place, inputs, outputs):
    put(tensors, f"{place}.in_layers.0", affine(inputs))
    put(tensors, f"{place}.in_layers.2", affine(outputs, inputs, 3, 3))
    put(tensors, f"{place}.emb_layers.1", affine(outputs, 4 * BASE))
    put(tensors, f"{place}.out_layers.0", affine(outputs))
    put(tensors, f"{place}.out_layers.3", affine(outputs, outputs, 3, 3))
    if inputs != outputs:
        put(tensors, f"{place}.skip_connection", affine(outputs, inputs, 1, 1))


def transformer(tensors, place, channels, sees_itself):
    put(tensors, f"{place}.norm", affine(channels))
    put(tensors, f"{place}.proj_in", affine(channels, channels))
    block = f"{place}.transformer_blocks.0"
    for attention, source in [("attn1", channels if sees_itself else WIDTH), ("attn2", WIDTH)]:
        tensors[f"{block}.{attention}.to_q.weight"] = (channels, channels)
        tensors[f"{block}.{attention}.to_k.weight"] = tensors[f"{block}.{attention}.to_v.weight"] = (channels, source)
        put(tensors, f"{block}.{attention}.to_out.0", affine(channels, channels))
    put(tensors, f"{block}.ff.net.0.proj", affine(8 * channels, channels))
    put(tensors, f"{block}.ff.net.2", affine(channels, 4 * channels))
    for i in (1, 2, 3):
        put(tensors, f"{block}.norm{i}", affine(channels))
    put(tensors, f"{place}.proj_out", affine(channels, channels))


def unet_shapes():
    tensors, last = {}, len(MULTIPLES) - 1
    put(tensors, "time_embed.0", affine(4 * BASE, BASE))
    put(tensors, "time_embed.2", affine(4 * BASE, 4 * BASE))
    tensors["label_emb.weight"] = (CLASSES, 4 * BASE)
    put(tensors, "input_blocks.0.0", affine(BASE, LATENT + 3, 3, 3))
    channels, skips, at = BASE, [BASE], 1
    for level, multiple in enumerate(MULTIPLES):
        for _ in range(RESNETS):
            unet_resnet(tensors, f"input_blocks.{at}.0", channels, multiple * BASE)
            channels = multiple * BASE
            if level:
                transformer(tensors, f"input_blocks.{at}.1", channels, level == last)
            skips.append(channels)
            at += 1
        if level != last:
            put(tensors, f"input_blocks.{at}.0.op", affine(channels, channels, 3, 3))
            skips.append(channels)
            at += 1
    unet_resnet(tensors, "middle_block.0", channels, channels)
    transformer(tensors, "middle_block.1", channels, True)
    unet_resnet(tensors, "middle_block.2", channels, channels)
    at = 0
    for level, multiple in reversed(list(enumerate(MULTIPLES))):
        for i in range(RESNETS + 1):
            unet_resnet(tensors, f"output_blocks.{at}.0", channels + skips.pop(), multiple * BASE)
            channels = multiple * BASE
            if level:
                transformer(tensors, f"output_blocks.{at}.1", channels, level == last)
            if level and i == RESNETS:
                put(tensors, f"output_blocks.{at}.2.conv", affine(channels, channels, 3, 3))
            at += 1
    put(tensors, "out.0", affine(channels))
    put(tensors, "out.2", affine(LATENT, channels, 3, 3))
    return tensors


def vae_resnet(tensors, place, inputs, outputs):
    put(tensors, f"{place}.norm1", affine(inputs))
    put(tensors, f"{place}.conv1", affine(outputs, inputs, 3, 3))
    put(tensors, f"{place}.norm2", affine(outputs))
    put(tensors, f"{place}.conv2", affine(outputs, outputs, 3, 3))
    if inputs != outputs:
        put(tensors, f"{place}.nin_shortcut", affine(outputs, inputs, 1, 1))


def vae_middle(tensors, place, channels):
    vae_resnet(tensors, f"{place}.block_1", channels, channels)
    put(tensors, f"{place}.attn_1.norm", affine(channels))
    for layer in ("q", "k", "v", "proj_out"):
        put(tensors, f"{place}.attn_1.{layer}", affine(channels, channels, 1, 1))
    vae_resnet(tensors, f"{place}.block_2", channels, channels)


def vae_shapes():
    tensors, last, channels = {}, len(VAE_MULTIPLES) - 1, VAE_BASE
    put(tensors, "encoder.conv_in", affine(channels, 3, 3, 3))
    for level, multiple in enumerate(VAE_MULTIPLES):
        for i in range(RESNETS):
            vae_resnet(tensors, f"encoder.down.{level}.block.{i}", channels, multiple * VAE_BASE)
            channels = multiple * VAE_BASE
        if level != last:
            put(tensors, f"encoder.down.{level}.downsample.conv", affine(channels, channels, 3, 3))
    vae_middle(tensors, "encoder.mid", channels)
    put(tensors, "encoder.norm_out", affine(channels))
    put(tensors, "encoder.conv_out", affine(2 * LATENT, channels, 3, 3))
    put(tensors, "decoder.conv_in", affine(channels, LATENT, 3, 3))
    vae_middle(tensors, "decoder.mid", channels)
    for level, multiple in reversed(list(enumerate(VAE_MULTIPLES))):
        for i in range(RESNETS + 1):
            vae_resnet(tensors, f"decoder.up.{level}.block.{i}", channels, multiple * VAE_BASE)
            channels = multiple * VAE_BASE
        if level:
            put(tensors, f"decoder.up.{level}.upsample.conv", affine(channels, channels, 3, 3))
    put(tensors, "decoder.norm_out", affine(channels))
    put(tensors, "decoder.conv_out", affine(3, channels, 3, 3))
    put(tensors, "quant_conv", affine(2 * LATENT, 2 * LATENT, 1, 1))
    put(tensors, "post_quant_conv", affine(LATENT, LATENT, 1, 1))
    return tensors


def text_shapes():
    tensors = {"positional_embedding": (LENGTH, WIDTH), "token_embedding.weight": (WORDS, WIDTH)}
    for i in range(LAYERS):
        place = f"transformer.resblocks.{i}"
        put(tensors, f"{place}.ln_1", affine(WIDTH))
        tensors[f"{place}.attn.in_proj_weight"], tensors[f"{place}.attn.in_proj_bias"] = (3 * WIDTH, WIDTH), (3 * WIDTH,)
        put(tensors, f"{place}.attn.out_proj", affine(WIDTH, WIDTH))
        put(tensors, f"{place}.ln_2", affine(WIDTH))
        put(tensors, f"{place}.mlp.c_fc", affine(4 * WIDTH, WIDTH))
        put(tensors, f"{place}.mlp.c_proj", affine(WIDTH, 4 * WIDTH))
    put(tensors, "ln_final", affine(WIDTH))
    # What has no say in the states.
    tensors["text_projection"], tensors["logit_scale"] = (WIDTH, WIDTH), ()
    return tensors


def single_file():
    """All tensors by name: gains around 1, all else small enough for the next layer, rounded towards zero to BF16."""
    shapes = {"betas": (8,), "low_scale_model.betas": (8,)}
    for prefix, part in ((UNET, unet_shapes()), (VAE, vae_shapes()), (TEXT, text_shapes())):
        shapes.update({prefix + name: shape for name, shape in part.items()})
    tensors = {}
    for k, (name, shape) in enumerate(sorted(shapes.items())):
        values = numbers(50_000 + k, shape or (1,)).numpy()
        if len(shape) < 2:
            gain, offset = 0.1, name.endswith("weight")
        else:
            gain, offset = (3 / np.prod(shape[1:])) ** 0.5, 0
        values = (np.float32(gain) * values + np.float32(offset)).astype(np.float32)
        rounded = (values.view(np.uint32) & np.uint32(0xFFFF0000)).view(np.float32)
        tensors[name] = torch.from_numpy(rounded.copy()).reshape(shape)
    return tensors


def unet_model(tensors):
    levels = len(MULTIPLES)
    unet = UNet2DConditionModel(
        sample_size=128, in_channels=LATENT + 3, out_channels=LATENT, block_out_channels=[m * BASE for m in MULTIPLES],
        layers_per_block=RESNETS,
        down_block_types=["DownBlock2D"] + ["CrossAttnDownBlock2D"] * (levels - 1),
        up_block_types=["CrossAttnUpBlock2D"] * (levels - 1) + ["UpBlock2D"], only_cross_attention=[True] * (levels - 1) + [False],
        attention_head_dim=8, cross_attention_dim=WIDTH, num_class_embeds=CLASSES, use_linear_projection=True,
    ).eval()
    unet.load_state_dict(convert_ldm_unet_checkpoint(tensors, unet.config))
    return unet


def vae_model(tensors):
    levels = len(VAE_MULTIPLES)
    vae = AutoencoderKL(
        block_out_channels=[m * VAE_BASE for m in VAE_MULTIPLES], layers_per_block=RESNETS, latent_channels=LATENT, scaling_factor=0.08333,
        down_block_types=["DownEncoderBlock2D"] * levels, up_block_types=["UpDecoderBlock2D"] * levels, sample_size=256,
    ).eval()
    vae.load_state_dict(convert_ldm_vae_checkpoint(tensors, vae.config))
    return vae


def text_model(tensors):
    """The states are those before the last layer: its weights have no place in diffusers' folder."""
    text = CLIPTextModel(CLIPTextConfig(
        vocab_size=WORDS, hidden_size=WIDTH, intermediate_size=4 * WIDTH, num_hidden_layers=LAYERS - 1, num_attention_heads=WIDTH // 64,
        max_position_embeddings=LENGTH, hidden_act="gelu", bos_token_id=WORDS - 2, eos_token_id=WORDS - 1, pad_token_id=0,
    )).eval()
    converted = convert_open_clip_checkpoint(text, tensors)
    nested = any(name.startswith("text_model.") for name in text.state_dict())
    unread = (f"text_model.encoder.layers.{LAYERS - 1}.", "text_projection")
    kept = {name: tensor for name, tensor in converted.items() if not name.startswith(unread)}
    text.load_state_dict({name if nested else name.removeprefix("text_model."): tensor for name, tensor in kept.items()})
    return text, kept


def names(tensors, parts):
    """For each tensor of the single file its shape and the places that its bytes take in the folder: [part, name]."""
    places = {}
    for part, converted in parts.items():
        for name, tensor in converted.items():
            places.setdefault(tensor.numpy().tobytes(), []).append([part, name])
    rows = []
    for name, tensor in sorted(tensors.items()):
        whole = places.get(tensor.numpy().tobytes(), [])
        thirds = [places.get(third.contiguous().numpy().tobytes(), []) for third in (tensor.chunk(3) if "in_proj" in name else [])]
        assert len(whole) <= 1 and all(len(third) <= 1 for third in thirds), name
        rows.append([name, list(tensor.shape), whole + sum(thirds, [])])
    assert sum(len(row[2]) for row in rows) == sum(map(len, parts.values()))
    return rows


def write_both(out, tiny, tensors, models, tokenizer):
    out.mkdir(parents=True, exist_ok=True)
    save_file(tensors, out / "x4.safetensors")
    for table in ("vocab.json", "merges.txt"):
        shutil.copy(tiny / "tokenizer" / table, out / table)
    for part, model in models.items():
        model.save_pretrained(out / "folder" / part)
    tokenizer.save_pretrained(out / "folder" / "tokenizer")
    schedule = dict(beta_start=1e-4, beta_end=0.02, beta_schedule="scaled_linear")
    DDIMScheduler(prediction_type="v_prediction", **schedule).save_pretrained(out / "folder" / "scheduler")
    DDPMScheduler(**schedule).save_pretrained(out / "folder" / "low_res_scheduler")


def main(tiny, out=None):
    tensors = single_file()
    unet, vae = unet_model(tensors), vae_model(tensors)
    text, text_tensors = text_model(tensors)
    rows = names(tensors, {"unet": unet.state_dict(), "vae": vae.state_dict(), "text_encoder": text_tensors})
    (HERE / "single_file.json").write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    tokenizer = CLIPTokenizer.from_pretrained(tiny / "tokenizer", pad_token="!", model_max_length=LENGTH)
    prompts = ["high resolution, 4K, photo", ""]
    ids = tokenizer(prompts, padding="max_length", max_length=LENGTH, truncation=True, return_tensors="pt").input_ids
    results = {}
    with torch.no_grad():
        results["text.states"] = text(ids).last_hidden_state
        unet_case(results, unet, "unet", (16, 8), (9, WIDTH), 10, True)
    vae_case(results, vae, LATENT, 30)
    save_file({name: tensor.contiguous() for name, tensor in results.items()}, HERE / "single_file.safetensors")
    if out:
        write_both(out, tiny, tensors, {"unet": unet, "vae": vae, "text_encoder": text}, tokenizer)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(*map(Path, sys.argv[1:3]))
