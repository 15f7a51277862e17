"""python time_networks.py MODEL_FOLDER: what time_networks.rs prints, by PyTorch and diffusers with 2 threads."""

import sys
import time
from pathlib import Path

import torch
from diffusers import AutoencoderKL, UNet2DConditionModel
from peft import LoraConfig


def fastest(run):
    times = []
    for _ in range(5):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return f"{min(times) * 1e3:.0f} ms"


def main(folder):
    torch.set_num_threads(2)
    unet = UNet2DConditionModel.from_pretrained(folder / "unet", torch_dtype=torch.float32).eval().requires_grad_(False)
    unet.add_adapter(LoraConfig(r=4, lora_alpha=4, target_modules=["to_q", "to_k", "to_v", "to_out.0"]))
    for batch in (1, 2):
        sample, text = torch.randn(batch, 19, 48, 64), torch.randn(batch, 77, 32)
        t = torch.full((batch,), 500)
        predict = lambda: unet(sample, t, text, class_labels=torch.full((batch,), 20)).sample
        unet.disable_adapters()
        with torch.no_grad():
            forward = fastest(predict)
        unet.enable_adapters()
        training = fastest(lambda: (predict() ** 2).mean().backward())
        print(f"batch {batch}: forward {forward}, LoRA forward and backward {training}")
    vae = AutoencoderKL.from_pretrained(folder / "vae", torch_dtype=torch.float32).eval()
    with torch.no_grad():
        latent = torch.randn(1, 16, 48, 64)
        print(f"decode to 256x192: {fastest(lambda: vae.decode(latent))}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
