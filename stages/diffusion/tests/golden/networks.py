"""What diffusers, transformers and peft compute, for the tests of the networks beside this script.

python networks.py MODEL_FOLDER, with the folder of tiny-x4. Writes into the script's folder:
  tokens.json          ids of odd prompts
  tiny.safetensors     tiny-x4: text states, UNet, autoencoder
  tiny_lora.safetensors  tiny-x4 with an adapter and a camera: output and gradients
  other.json           configurations and tensor shapes of a model of another shape, whose weights follow a formula
  other.safetensors    what that model computes
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
from diffusers import AutoencoderKL, UNet2DConditionModel
from peft import LoraConfig
from peft.utils import get_peft_model_state_dict
from safetensors.torch import save_file
from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

HERE = Path(__file__).parent
PROMPTS = [
    "", "high resolution, 4K, photo", "blurry, low quality", "  Don't   SHOUT!!  it's\t42° & 1/2\n", "Ünïcödé: straße, ÅNGSTRÖM e\u0301 İstanbul",
    "日本語 テスト 🙂👍🏽", "<|endoftext|> in the middle <|startoftext|>", "a'b'c 'tis rock'n'roll we'LL they'Ve", "snake_case--dash...dots?!", "x" * 300,
    " ".join(str(i) for i in range(100)), "\u00a0no\u2003break \u00ad soft\u200bzero ½ Ⅷ ² ൩", "فارسی עברית हिन्दी",
]
TARGETS = ["to_q", "to_k", "to_v", "to_out.0"]


def numbers(stream, shape):
    """Pseudo-random numbers in [-1, 1), the same on both sides: a hash of the stream and the element's index."""
    i = np.arange(1, int(np.prod(shape)) + 1, dtype=np.uint64)
    h = i * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream * 0xBF58476D1CE4E5B9 % 2**64)
    h = (h ^ (h >> np.uint64(31))) * np.uint64(0x94D049BB133111EB)
    h = h ^ (h >> np.uint64(29))
    return torch.from_numpy(((h >> np.uint64(40)).astype(np.float64) / 2**23 - 1).astype(np.float32)).reshape(shape)


def fill(named, first_stream, scale=None):
    """Fills tensors in the order of their names: gains around 1, all else small enough for the next layer."""
    for k, (name, tensor) in enumerate(sorted(named.items())):
        values = numbers(first_stream + k, tensor.shape)
        if scale is not None:
            values = scale * values
        elif tensor.dim() == 1:
            values = 0.1 * values + (1 if name.endswith("weight") else 0)
        else:
            values = values * (3 / tensor[0].numel()) ** 0.5
        with torch.no_grad():
            tensor.copy_(values)


def camera_embedding(unet):
    """The camera embedding, hooked in behind the time embedding; its input is set through the returned list."""
    width = unet.time_embedding.linear_2.out_features
    layers = torch.nn.ModuleDict({"linear_1": torch.nn.Linear(16, width), "linear_2": torch.nn.Linear(width, width)})
    fill(dict(layers.named_parameters()), 900, 0.1)
    camera = []
    embed = lambda c: layers["linear_2"](torch.nn.functional.silu(layers["linear_1"](c)))
    unet.time_embedding.register_forward_hook(lambda module, args, out: out + embed(camera[0]) if camera else out)
    return layers, camera


def unet_case(out, unet, name, size, text_shape, stream, classes, lora=None):
    """One forward pass on numbers, and with an adapter the gradients of the mean squared error to numbers."""
    n, t = 2, torch.tensor([981, 37])
    sample = numbers(stream, (n, unet.config.in_channels, *size)).requires_grad_(lora is not None)
    text = numbers(stream + 1, (n, *text_shape))
    labels = torch.tensor([20, 3]) if classes else None
    if lora:
        lora["camera"][:] = [numbers(stream + 2, (n, 16))]
    y = unet(sample, t, text, class_labels=labels).sample
    out[f"{name}.out"] = y.detach()
    if lora:
        ((y - numbers(stream + 3, y.shape)) ** 2).mean().backward()
        out[f"{name}.grad.sample"] = sample.grad
        for key, parameter in lora["parameters"].items():
            out[f"{name}.grad.{key}"] = parameter.grad


def add_lora(unet, rank, alpha):
    unet.requires_grad_(False)
    unet.add_adapter(LoraConfig(r=rank, lora_alpha=alpha, target_modules=TARGETS))
    layers, camera = camera_embedding(unet)
    adapters = {f"unet.{k.replace('.default', '')}": p for k, p in unet.named_parameters() if "lora_" in k}
    assert set(adapters) == {f"unet.{k}" for k in get_peft_model_state_dict(unet)}
    fill(adapters, 1000, 0.1)
    embedding = {f"camera_embedding.{k}": p for k, p in layers.named_parameters()}
    return {"parameters": {**adapters, **embedding}, "camera": camera}


def vae_case(out, vae, latent, stream):
    with torch.no_grad():
        posterior = vae.encode(numbers(stream, (1, 3, 40, 32))).latent_dist
        out["vae.mean"], out["vae.logvar"] = posterior.mean, posterior.logvar
        out["vae.decoded"] = vae.decode(numbers(stream + 1, (1, latent, 10, 8))).sample


def tiny(folder):
    tokenizer = CLIPTokenizer.from_pretrained(folder / "tokenizer")
    ids = tokenizer(PROMPTS, padding="max_length", max_length=77, truncation=True).input_ids
    rows = [json.dumps({"text": text, "ids": row}) for text, row in zip(PROMPTS, ids)]
    (HERE / "tokens.json").write_text("[\n" + ",\n".join(rows) + "\n]\n")
    load = dict(torch_dtype=torch.float32)
    unet = UNet2DConditionModel.from_pretrained(folder / "unet", **load).eval()
    out, text = {}, CLIPTextModel.from_pretrained(folder / "text_encoder", **load).eval()
    with torch.no_grad():
        out["text.states"] = text(torch.tensor(ids[1:5])).last_hidden_state
        unet_case(out, unet, "even", (12, 16), (77, 32), 10, True)
        unet_case(out, unet, "odd", (11, 15), (77, 32), 20, True)
    vae_case(out, AutoencoderKL.from_pretrained(folder / "vae", **load).eval(), 16, 30)
    save_file(out, HERE / "tiny.safetensors")
    out = {}
    unet_case(out, unet, "lora", (7, 10), (77, 32), 40, True, add_lora(unet, 3, 6))
    keep = ("camera_embedding.linear_2.weight",)  # 256x256: too large a file
    save_file({k: v.contiguous() for k, v in out.items() if not k.endswith(keep)}, HERE / "tiny_lora.safetensors")


def other(folder):
    unet_config = dict(
        in_channels=7, out_channels=4, block_out_channels=[16, 24, 32, 32], layers_per_block=2, norm_num_groups=8, norm_eps=1e-6,
        down_block_types=["CrossAttnDownBlock2D", "DownBlock2D", "CrossAttnDownBlock2D", "DownBlock2D"],
        up_block_types=["UpBlock2D", "CrossAttnUpBlock2D", "UpBlock2D", "CrossAttnUpBlock2D"],
        only_cross_attention=[False, True, True, False], attention_head_dim=[2, 3, 4, 8], cross_attention_dim=40,
        transformer_layers_per_block=[1, 1, 2, 1], use_linear_projection=False, flip_sin_to_cos=False, freq_shift=1,
    )
    vae_config = dict(
        block_out_channels=[16, 24], layers_per_block=2, norm_num_groups=4, latent_channels=4, scaling_factor=0.08333,
        down_block_types=["DownEncoderBlock2D"] * 2, up_block_types=["UpDecoderBlock2D"] * 2, use_quant_conv=False,
    )
    text_config = dict(
        vocab_size=768, hidden_size=40, intermediate_size=96, num_hidden_layers=2, num_attention_heads=5, hidden_act="quick_gelu",
        bos_token_id=766, eos_token_id=767, pad_token_id=767,
    )
    models = {
        "unet": UNet2DConditionModel(**unet_config).eval(),
        "vae": AutoencoderKL(**vae_config).eval(),
        "text_encoder": CLIPTextModel(CLIPTextConfig(**text_config)).eval(),
    }
    for stream, model in zip((10_000, 20_000, 30_000), models.values()):
        fill(dict(model.named_parameters()), stream)
    configs = {"unet": dict(models["unet"].config), "vae": dict(models["vae"].config), "text_encoder": text_config}
    shapes = {part: {k: list(p.shape) for k, p in sorted(model.named_parameters())} for part, model in models.items()}
    (HERE / "other.json").write_text(json.dumps({"configs": configs, "shapes": shapes}, default=list) + "\n")
    tokenizer = CLIPTokenizer.from_pretrained(folder / "tokenizer")
    ids = tokenizer(PROMPTS[1:3], padding="max_length", max_length=77, truncation=True, return_tensors="pt").input_ids
    out = {}
    with torch.no_grad():
        out["text.states"] = models["text_encoder"](ids).last_hidden_state
        unet_case(out, models["unet"], "even", (16, 8), (9, 40), 10, False)
        unet_case(out, models["unet"], "odd", (13, 21), (9, 40), 20, False)
    vae_case(out, models["vae"], 4, 30)
    unet_case(out, models["unet"], "lora", (6, 9), (9, 40), 40, False, add_lora(models["unet"], 2, 1))
    save_file({k: v.contiguous() for k, v in out.items()}, HERE / "other.safetensors")


if __name__ == "__main__":
    torch.set_num_threads(1)
    tiny(Path(sys.argv[1]))
    other(Path(sys.argv[1]))
