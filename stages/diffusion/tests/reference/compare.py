"""Our networks beside diffusers, transformers and peft, on models that are drawn anew.

python compare.py PROGRAM [--seed 0] [--count 8] [--full]

Draws models of random shapes, saves them with save_pretrained, runs `PROGRAM model run` on them and prints how far the two are
apart: the norm of the difference over the norm of PyTorch's result. Fails above 1e-4, unless PyTorch itself moves a fourth as far when
the input moves by half a unit in the last place: some drawn networks normalise groups of one or two numbers, and are ill-conditioned.
--full adds the x4 upscaler at its own size.
"""

import argparse
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
from diffusers import AutoencoderKL, StableDiffusionUpscalePipeline, UNet2DConditionModel
from diffusers.training_utils import _collate_lora_metadata
from models import X4_TEXT, X4_UNET, X4_VAE, add_lora, describe, random_text, random_unet, random_vae, spread
from peft.utils import get_peft_model_state_dict
from safetensors.torch import load_file, save_file
from transformers import CLIPTextConfig, CLIPTextModel

LIMIT = 1e-4


def distance(ours, theirs):
    return ((ours - theirs).norm() / theirs.norm().clamp_min(1e-30)).item()


class Comparison:
    def __init__(self, program, folder):
        self.program, self.folder, self.worst, self.failed, self.unsure = program, Path(folder), 0.0, [], 0.0

    def run(self, part, inputs, *options):
        save_file({k: v.contiguous() for k, v in inputs.items()}, self.folder / "in.safetensors")
        files = ["--input", self.folder / "in.safetensors", "--output", self.folder / "out.safetensors"]
        done = subprocess.run([self.program, "model", "run", self.folder, "--part", part, *files, *options], capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{part}: {done.stderr}")
        return load_file(self.folder / "out.safetensors")

    def expect(self, what, ours, theirs, config, exact=None, nudged=()):
        assert ours.shape == theirs.shape, (what, ours.shape, theirs.shape)
        off = distance(ours, theirs)
        if off < LIMIT:
            self.worst = max(self.worst, off)
            return
        unsure = max((distance(other, exact) for other in (theirs, *nudged)), default=0) if exact is not None else 0
        if exact is not None and distance(ours, exact) < max(LIMIT, 4 * unsure):
            self.unsure = max(self.unsure, off / unsure)
            return
        self.worst = max(self.worst, off)
        self.failed.append(what)
        print(f"{what} is off by {off:.1e} of its norm; rounding the input moves it by {unsure:.1e}: {describe(config)}", flush=True)

    def unet(self, unet, draw, size, batch, stored=torch.float32):
        config = unet.config
        unet.to(stored).save_pretrained(self.folder / "unet")
        unet.to(torch.float32)
        width = config.cross_attention_dim
        inputs = {
            "sample": torch.randn(batch, config.in_channels, *size),
            "timestep": torch.tensor([draw.randrange(1000) for _ in range(batch)]),
            "encoder_hidden_states": torch.randn(batch, 77, width),
        }
        if config.num_class_embeds:
            inputs["class_labels"] = torch.tensor([draw.randrange(config.num_class_embeds) for _ in range(batch)])
        with torch.no_grad():
            theirs = unet(**inputs).sample
        self.expect("unet", self.run("unet", inputs)["sample"], theirs, config)
        if any("attentions" in name for name, _ in unet.named_parameters()):
            self.lora(unet, draw, inputs, theirs)

    def lora(self, unet, draw, inputs, plain):
        rank, alpha = draw.choice([1, 2, 4, 8]), draw.choice([1, 4, 6])
        add_lora(unet, rank, alpha, draw.choice([["to_q", "to_k", "to_v", "to_out.0"], ["to_q", "to_v"]]))
        file, prefix = self.save_lora(unet, draw, rank == alpha)
        inputs["target"] = torch.randn_like(plain)
        keep = str(draw.choice([0, 64]))
        ours = self.run("unet", inputs, "--lora", file, "--target-grad", "--keep", keep)
        theirs = gradients(unet, inputs, prefix)
        assert set(ours) == set(theirs), set(ours) ^ set(theirs)
        unchecked = [name for name in theirs if distance(ours[name], theirs[name]) >= LIMIT]
        exact, nudged = conditioning(unet, inputs, prefix) if unchecked else ({}, [])
        for name, expected in theirs.items():
            self.expect(f"lora {name}", ours[name], expected, unet.config, exact.get(name), [other[name] for other in nudged])
        unet.float().delete_adapters("default")

    def save_lora(self, unet, draw, alpha_is_rank):
        """In one of the layouts that the libraries write; without metadata where that says the same."""
        layout = draw.choice(["pipeline", "unet"] + ["bare"] * alpha_is_rank)
        if layout == "unet":
            unet.save_lora_adapter(self.folder / "lora")
            return self.folder / "lora" / "pytorch_lora_weights.safetensors", ""
        metadata = _collate_lora_metadata({"unet": unet}) if layout == "pipeline" else {}
        StableDiffusionUpscalePipeline.save_lora_weights(self.folder / "lora", unet_lora_layers=get_peft_model_state_dict(unet), **metadata)
        return self.folder / "lora" / "pytorch_lora_weights.safetensors", "unet."

    def vae(self, vae, size, batch):
        vae.save_pretrained(self.folder / "vae")
        sample, latent = torch.rand(batch, 3, *size) * 2 - 1, torch.randn(batch, vae.config.latent_channels, size[0] // 4 + 1, size[1] // 4 + 2)
        with torch.no_grad():
            posterior, decoded = vae.encode(sample).latent_dist, vae.decode(latent).sample
        ours = self.run("vae-encode", {"sample": sample})
        self.expect("vae mean", ours["mean"], posterior.mean, vae.config)
        self.expect("vae logvar", ours["logvar"], posterior.logvar, vae.config)
        self.expect("vae decoded", self.run("vae-decode", {"latent": latent})["sample"], decoded, vae.config)

    def text(self, text, draw):
        text.save_pretrained(self.folder / "text_encoder")
        config = text.config
        ids = torch.tensor([[draw.randrange(config.vocab_size) for _ in range(config.max_position_embeddings)] for _ in range(2)])
        with torch.no_grad():
            theirs = text(ids).last_hidden_state
        self.expect("text", self.run("text", {"input_ids": ids})["last_hidden_state"], theirs, config.to_dict())


def gradients(unet, inputs, prefix):
    """The output, the loss, and its gradients by the sample and the adapter, under the names that they have in our file."""
    sample = inputs["sample"].clone().requires_grad_()
    output = unet(**{k: v for k, v in inputs.items() if k not in ("target", "sample")}, sample=sample).sample
    loss = ((output - inputs["target"]) ** 2).mean()
    unet.zero_grad()
    loss.backward()
    adapters = {f"grad.{prefix}{k.replace('.default', '')}": p.grad.clone() for k, p in unet.named_parameters() if "lora_" in k}
    return {"sample": output.detach(), "loss": loss.detach(), "grad.sample": sample.grad, **adapters}


def conditioning(unet, inputs, prefix):
    """The gradients in f64; and in f32 those of five samples that differ from the given one by about its rounding."""
    samples = [inputs["sample"] * (1 + 2.0**-24 * torch.randn_like(inputs["sample"])) for _ in range(5)]
    nudged = [gradients(unet, inputs | {"sample": sample}, prefix) for sample in samples]
    return gradients(unet.double(), {k: v.double() if v.is_floating_point() else v for k, v in inputs.items()}, prefix), nudged


def drawn(program, draw):
    with tempfile.TemporaryDirectory() as folder:
        comparison = Comparison(program, folder)
        size, batch = [draw.randrange(5, 20), draw.randrange(5, 20)], draw.choice([1, 2, 3])
        comparison.unet(spread(random_unet(draw)), draw, size, batch)
        comparison.vae(spread(random_vae(draw)), [draw.randrange(9, 50), draw.randrange(9, 50)], batch)
        comparison.text(spread(random_text(draw)), draw)
        return comparison


def full(program, draw):
    with tempfile.TemporaryDirectory() as folder:
        comparison = Comparison(program, folder)
        comparison.unet(spread(UNet2DConditionModel(**X4_UNET)), draw, [64, 64], 1)
        comparison.vae(spread(AutoencoderKL(**X4_VAE)), [96, 128], 1)
        comparison.text(spread(CLIPTextModel(CLIPTextConfig(**X4_TEXT))), draw)
        return comparison


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--full", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(2)
    runs = [(drawn, seed) for seed in range(args.seed, args.seed + args.count)] + [(full, args.seed)] * args.full
    failed = []
    for run, seed in runs:
        torch.manual_seed(seed)
        try:
            comparison = run(args.program.resolve(), random.Random(seed))
        except ValueError as refusal:
            # It has no group norm of a single number.
            print(f"{run.__name__} {seed}: PyTorch refuses it: {refusal}", flush=True)
            continue
        failed += comparison.failed
        unsure = f"; where it is ill-conditioned, {comparison.unsure:.1f} times what rounding the input does" if comparison.unsure else ""
        print(f"{run.__name__} {seed}: at most {comparison.worst:.1e} of the norm{unsure}", flush=True)
    sys.exit(f"{len(failed)} results are off by more than {LIMIT}" if failed else 0)


if __name__ == "__main__":
    main()
