"""Models with random weights, saved as diffusers saves them: of shapes drawn at random, and of the x4 upscaler's own."""

import json
import random

import torch
from diffusers import AutoencoderKL, UNet2DConditionModel
from peft import LoraConfig
from transformers import CLIPTextConfig, CLIPTextModel

TARGETS = ["to_q", "to_k", "to_v", "to_out.0"]

# stabilityai/stable-diffusion-x4-upscaler.
X4_UNET = dict(
    sample_size=128, in_channels=7, out_channels=4, block_out_channels=[256, 512, 512, 1024], layers_per_block=2,
    down_block_types=["DownBlock2D"] + ["CrossAttnDownBlock2D"] * 3, up_block_types=["CrossAttnUpBlock2D"] * 3 + ["UpBlock2D"],
    only_cross_attention=[True, True, True, False], attention_head_dim=8, cross_attention_dim=1024, num_class_embeds=1000,
    use_linear_projection=True,
)
X4_VAE = dict(
    block_out_channels=[128, 256, 512], layers_per_block=2, latent_channels=4, scaling_factor=0.08333, sample_size=256,
    down_block_types=["DownEncoderBlock2D"] * 3, up_block_types=["UpDecoderBlock2D"] * 3,
)
X4_TEXT = dict(
    vocab_size=49408, hidden_size=1024, intermediate_size=4096, num_hidden_layers=23, num_attention_heads=16, hidden_act="gelu",
    bos_token_id=0, eos_token_id=2, pad_token_id=1,
)


def random_unet(draw: random.Random):
    """A small UNet whose every size is another one."""
    blocks, groups = draw.choice([2, 3, 4]), draw.choice([2, 4, 8])
    heads = [draw.choice([1, 2, 4]) for _ in range(blocks)] if draw.random() < 0.5 else draw.choice([1, 2, 4])
    crossed = [draw.random() < 0.6 for _ in range(blocks)]
    config = dict(
        in_channels=draw.choice([4, 7, 9]), out_channels=draw.choice([3, 4, 8]), norm_num_groups=groups,
        block_out_channels=[8 * draw.choice([1, 2, 3, 4]) for _ in range(blocks)],
        layers_per_block=draw.choice([1, 2, 3]) if draw.random() < 0.7 else [draw.choice([1, 2]) for _ in range(blocks)],
        down_block_types=["CrossAttnDownBlock2D" if c else "DownBlock2D" for c in crossed],
        up_block_types=["CrossAttnUpBlock2D" if c else "UpBlock2D" for c in reversed(crossed)],
        only_cross_attention=[draw.random() < 0.5 for _ in range(blocks)] if draw.random() < 0.7 else draw.random() < 0.5,
        attention_head_dim=heads, cross_attention_dim=draw.choice([16, 24, 40]), use_linear_projection=draw.random() < 0.5,
        num_class_embeds=draw.choice([None, 10, 1000]), norm_eps=draw.choice([1e-5, 1e-6]), flip_sin_to_cos=draw.random() < 0.7,
        freq_shift=draw.choice([0, 1]), upcast_attention=draw.random() < 0.2, sample_size=draw.choice([16, 32]),
    )
    if isinstance(config["layers_per_block"], int) and draw.random() < 0.3:
        config["transformer_layers_per_block"] = draw.choice([2, [draw.choice([1, 2]) for _ in range(blocks)]])
    return UNet2DConditionModel(**config)


def random_vae(draw: random.Random):
    blocks = draw.choice([1, 2, 3, 4])
    return AutoencoderKL(
        block_out_channels=[8 * draw.choice([1, 2, 3]) for _ in range(blocks)], layers_per_block=draw.choice([1, 2]),
        latent_channels=draw.choice([4, 8, 16]), norm_num_groups=draw.choice([2, 4, 8]), scaling_factor=draw.choice([0.18215, 0.08333]),
        down_block_types=["DownEncoderBlock2D"] * blocks, up_block_types=["UpDecoderBlock2D"] * blocks,
        mid_block_add_attention=draw.random() < 0.7, use_quant_conv=draw.random() < 0.7, use_post_quant_conv=draw.random() < 0.7,
    )


def random_text(draw: random.Random):
    heads = draw.choice([1, 2, 4])
    config = CLIPTextConfig(
        vocab_size=draw.choice([300, 1000]), hidden_size=8 * heads * draw.choice([1, 2]), intermediate_size=draw.choice([32, 96]),
        num_hidden_layers=draw.choice([1, 2, 3]), num_attention_heads=heads, hidden_act=draw.choice(["gelu", "quick_gelu"]),
        max_position_embeddings=draw.choice([77, 20]), layer_norm_eps=draw.choice([1e-5, 1e-6]),
        bos_token_id=298, eos_token_id=299, pad_token_id=299,
    )
    return CLIPTextModel(config)


def spread(model):
    """Random values in place of the ones and zeros of fresh norms and biases; the rest as the library draws them."""
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if parameter.dim() == 1:
                parameter.copy_(0.1 * torch.randn_like(parameter) + (1 if name.endswith("weight") else 0))
    return model.eval().requires_grad_(False)


def add_lora(unet, rank, alpha, targets=TARGETS):
    """An adapter of which no matrix is zero."""
    unet.add_adapter(LoraConfig(r=rank, lora_alpha=alpha, target_modules=targets))
    with torch.no_grad():
        for name, parameter in unet.named_parameters():
            if "lora_" in name:
                parameter.copy_(torch.randn_like(parameter) * (0.5 / parameter.shape[1] ** 0.5))


def describe(config):
    """What sets this configuration apart, on one line."""
    told = {k: v for k, v in config.items() if not k.startswith("_") and v is not None and not k.endswith("_types")}
    return json.dumps(told, default=str)
