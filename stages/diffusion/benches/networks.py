"""Time and memory of whole networks: ours beside PyTorch, two threads each.

python networks.py PROGRAM [--cases full tiny vae] [--repeat 3] [--turns 3]

The x4 upscaler has random weights here; tiny-x4 is the folder beside this script's. Every measurement is a process of its own, and
its memory is the most that the process has had resident (VmHWM), weights, libraries and all.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
TINY = HERE.parent / "models" / "tiny-x4"
THREADS = "2"


def prepare(case, folder):
    """Writes the model, its inputs and a LoRA; gives the model's folder."""
    import torch
    from safetensors.torch import save_file

    sys.path.append(str(HERE.parent / "tests" / "reference"))
    from diffusers import AutoencoderKL, StableDiffusionUpscalePipeline, UNet2DConditionModel
    from models import X4_UNET, X4_VAE, add_lora, spread
    from peft.utils import get_peft_model_state_dict

    torch.manual_seed(0)
    if case == "vae":
        spread(AutoencoderKL(**X4_VAE)).save_pretrained(folder / "vae")
        save_file({"latent": torch.randn(1, 4, 32, 32)}, folder / "in.safetensors")
        return folder
    model, size, batch = (TINY, 32, 4) if case == "tiny" else (folder, 64, 1)
    unet = UNet2DConditionModel.from_pretrained(TINY / "unet", torch_dtype=torch.float32) if case == "tiny" else spread(UNet2DConditionModel(**X4_UNET))
    if case == "full":
        unet.save_pretrained(folder / "unet")
    save_file({
        "sample": torch.randn(batch, unet.config.in_channels, size, size), "timestep": torch.full((batch,), 500),
        "encoder_hidden_states": torch.randn(batch, 77, unet.config.cross_attention_dim), "class_labels": torch.full((batch,), 20),
        "target": torch.randn(batch, unet.config.out_channels, size, size),
    }, folder / "in.safetensors")
    add_lora(unet, 4, 4)
    StableDiffusionUpscalePipeline.save_lora_weights(folder, unet_lora_layers=get_peft_model_state_dict(unet))
    return model


def ours(program, case, train, model, folder, repeat, keep):
    part = "vae-decode" if case == "vae" else "unet"
    files = ["--input", folder / "in.safetensors", "--output", folder / "out.safetensors", "--threads", THREADS]
    lora = ["--lora", folder / "pytorch_lora_weights.safetensors", "--target-grad", *keep] if train else []
    command = [program, "model", "run", model, "--part", part, *files, *lora, "--repeat", str(repeat), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    return told["forward_backward_ms" if train else "forward_ms"], told["peak_memory_bytes"]


def theirs(case, train, model, folder, repeat):
    command = [sys.executable, __file__, "--torch", case, str(int(train)), model, folder, str(repeat)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ, "OMP_NUM_THREADS": THREADS}).stdout)


def torch_side(case, train, model, folder, repeat):
    import torch
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from safetensors.torch import load_file

    torch.set_num_threads(int(THREADS))
    inputs = load_file(folder / "in.safetensors")
    if case == "vae":
        vae = AutoencoderKL.from_pretrained(model / "vae").eval().requires_grad_(False)
        run = lambda: vae.decode(inputs["latent"]).sample
    else:
        unet = UNet2DConditionModel.from_pretrained(model / "unet", torch_dtype=torch.float32).eval().requires_grad_(False)
        target = inputs.pop("target")
        if train:
            unet.load_lora_adapter(folder / "pytorch_lora_weights.safetensors", prefix="unet")
            for name, parameter in unet.named_parameters():
                parameter.requires_grad_("lora_" in name)
            inputs["sample"].requires_grad_()
        predict = lambda: unet(**inputs).sample
        run = (lambda: ((predict() - target) ** 2).mean().backward()) if train else predict
    times = []
    with torch.set_grad_enabled(bool(train)):
        for _ in range(repeat + 1):
            start = time.perf_counter()
            run()
            times.append((time.perf_counter() - start) * 1e3)
    peak = next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print(json.dumps([statistics.median(times[1:]), peak]))


def least(pairs):
    """The least time and the least memory of several (time, memory)."""
    return tuple(min(column) for column in zip(*pairs))


def measure(program, case, repeat, turns):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        prepared = subprocess.run([sys.executable, __file__, "--prepare", case, folder], capture_output=True, text=True, check=True)
        model = Path(prepared.stdout.strip().splitlines()[-1])
        for train in [False] if case == "vae" else [False, True]:
            keeps = [[], ["--keep", "1024"], ["--keep", "0"]] if train else [[]]
            runs = [lambda: theirs(case, train, model, folder, repeat)]
            runs += [lambda keep=keep: ours(program, case, train, model, folder, repeat, keep) for keep in keeps]
            # In turns: the machine's speed changes from minute to minute, and other programs only ever add to a time.
            rounds = [[run() for run in runs] for _ in range(turns)]
            (torch_time, torch_memory), *measured = map(least, zip(*rounds))
            for keep, (our_time, our_memory) in zip(keeps, measured):
                name = f"{case} {'forward and backward' if train else 'forward'}{' '.join(['', *keep])}"
                print(
                    f"{name:36} {our_time:8.0f} ms {torch_time:8.0f} ms {our_time / torch_time:6.2f}"
                    f" {our_memory / 1e9:8.2f} GB {torch_memory / 1e9:6.2f} GB {our_memory / torch_memory:6.2f}", flush=True,
                )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("--cases", nargs="+", default=["tiny", "vae", "full"])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--turns", type=int, default=3)
    args = parser.parse_args()
    print(f"{'':36} {'ours':>11} {'torch':>11} {'ratio':>6} {'ours':>11} {'torch':>9} {'ratio':>6}")
    for case in args.cases:
        measure(args.program, case, args.repeat, args.turns)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--torch", case, train, model, folder, repeat]:
            torch_side(case, int(train), Path(model), Path(folder), int(repeat))
        case ["--prepare", case, folder]:
            print(prepare(case, Path(folder)))
        case _:
            main()
