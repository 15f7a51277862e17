"""Trains the embedded upsampler, and goes on from its checkpoint.

    train.py CHECKPOINT --photos FOLDER... --drawn FOLDER --judge FOLDER --minutes N [--device cuda] [--threads N]

The rate holds for a part of the time and then falls to nothing; `CHECKPOINT.held` is the state before it fell, from which a
longer run goes on. `--export FILE` writes the averaged weights as safetensors in 16 bits, and `--start FILE` begins with such
weights where there is no checkpoint. Needs torch, numpy, pillow and safetensors. Start it with `nice`: the state is saved every
minute, and nothing is lost when it is stopped.
"""
import argparse
import copy
import os
import shutil
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from network import Muon, Residual, reduce
from pictures import Crops, photos

# A stop of more seconds (the machine slept, the process was paused) does not count as training.
PAUSE = 20


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--photos", nargs="+", default=[], help="folders of photos to learn from")
    parser.add_argument("--judge", default=None, help="a folder of photos that only judge")
    parser.add_argument("--minutes", type=float, default=60, help="all time spent, earlier runs with it")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--bf16", action="store_true", help="convolutions in bfloat16: twice as fast on a Zen 4 or a GPU")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--batch", type=int, default=6)
    parser.add_argument("--patch", type=int, default=48, help="side of a low-resolution crop")
    parser.add_argument("--drawn", nargs="+", default=[], help="folders of drawn pictures")
    parser.add_argument("--share", type=float, default=0.33, help="part of the crops that are of drawn pictures")
    parser.add_argument("--hold", type=float, default=0.4, help="part of the time before the rate falls")
    parser.add_argument("--rate", type=float, default=1, help="part of the usual rates, for weights that are nearly there")
    parser.add_argument("--start", type=Path, default=None)
    parser.add_argument("--export", type=Path, default=None)
    return parser.parse_args()


class Training:
    """Network, moving average, optimisers, and how far they are."""

    def __init__(self, options):
        self.options = options
        self.network = Residual(options.width, options.pairs).to(options.device, memory_format=torch.channels_last)
        self.average = copy.deepcopy(self.network)
        self.forward = torch.compile(self.network) if options.device == "cuda" else self.network
        hidden = [p for name, p in self.network.named_parameters() if p.ndim == 4 and not name.startswith(("first", "last"))]
        chosen = {id(p) for p in hidden}
        others = [p for p in self.network.parameters() if id(p) not in chosen]
        self.optimizers = [Muon(hidden, 0.01 * options.rate), torch.optim.Adam(others, 1e-3 * options.rate, betas=(0.9, 0.99))]
        self.rates = [optimizer.param_groups[0]["lr"] for optimizer in self.optimizers]
        self.step = 0
        self.seconds = 0.0

    def load(self, path):
        state = torch.load(path, map_location=self.options.device)
        self.network.load_state_dict(state["net"])
        self.average.load_state_dict(state["ema"])
        for optimizer, saved in zip(self.optimizers, state["opts"]):
            optimizer.load_state_dict(saved)
        self.step = state["k"]
        self.seconds = state["spent"]

    def begin_with(self, path):
        from safetensors.torch import load_file

        weights = {name: tensor.float() for name, tensor in load_file(path).items()}
        self.network.load_state_dict(weights)
        self.average.load_state_dict(weights)

    def save(self, path):
        state = {"net": self.network.state_dict(), "ema": self.average.state_dict(), "k": self.step, "spent": self.seconds}
        state["opts"] = [optimizer.state_dict() for optimizer in self.optimizers]
        torch.save(state, f"{path}.new")
        os.replace(f"{path}.new", path)

    def done(self):
        return min(1.0, self.seconds / (60 * self.options.minutes))

    def learn(self, high, low):
        """One step: absolute error first, squared error in the last two fifths or from a start, since PSNR is what judges."""
        done = self.done()
        hold = self.options.hold
        fall = 1 if done < hold else (1 - done) / (1 - hold)
        for optimizer, rate in zip(self.optimizers, self.rates):
            optimizer.param_groups[0]["lr"] = rate * min(1, (self.step + 1) / 100) * (fall + 0.002)
        with torch.autocast(self.options.device, torch.bfloat16, enabled=self.options.bf16):
            error = self.forward(low) - high
        squared = done >= 0.6 or self.options.start
        loss = error.square().mean() * 6 if squared else error.abs().mean()
        for optimizer in self.optimizers:
            optimizer.zero_grad()
        loss.backward()
        for optimizer in self.optimizers:
            optimizer.step()
        self.step += 1
        with torch.no_grad():
            weight = 1 - min(0.999, self.step / (self.step + 20))
            torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), weight)

    @torch.no_grad()
    def judge(self, images):
        """Mean PSNR of 256x384 crops in dB."""
        scores = []
        for high in images:
            low = (reduce(high) * 255).round().clamp(0, 255) / 255
            error = self.average(low.to(self.options.device)).clamp(0, 1).cpu() - high
            scores.append(-10 * error.square().mean().log10().item())
        return float(np.mean(scores)) if scores else float("nan")


def judges(folder):
    """The middle of every photo of a folder, [1, 3, 256, 384] from 0 to 1."""
    images = []
    for path in sorted(Path(folder).glob("*.png")) if folder else []:
        image = torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1)[None].float() / 255
        y, x = ((side - crop) // 2 for side, crop in zip(image.shape[2:], (256, 384)))
        images.append(image[:, :, y : y + 256, x : x + 384])
    return images


def export(network, path):
    from safetensors.torch import save_file

    save_file({name: tensor.half().contiguous() for name, tensor in network.state_dict().items()}, path)


def main():
    options = arguments()
    torch.set_num_threads(options.threads)
    torch.backends.cuda.matmul.allow_tf32 = True
    torch.backends.cudnn.benchmark = True
    torch.manual_seed(0)
    training = Training(options)
    if options.checkpoint.exists():
        training.load(options.checkpoint)
    elif options.start:
        training.begin_with(options.start)
    if options.export:
        return export(training.average, options.export)
    # A run that goes on sees other crops than the one before.
    random = np.random.default_rng(training.step)
    sets = [folders and Crops(photos(folders), options.patch, options.device, training.step) for folders in (options.drawn, options.photos)]
    share = options.share if options.drawn else 0

    def batch():
        drawn = int(random.binomial(options.batch, share))
        parts = [crops.batch(n) for crops, n in zip(sets, (drawn, options.batch - drawn)) if n]
        return [torch.cat(images) for images in zip(*parts)]

    tests = judges(options.judge)
    # The first step may compile; it takes no part of the time.
    training.learn(*batch())
    last = time.time()
    report = 0.0
    while True:
        now = time.time()
        training.seconds += min(now - last, PAUSE)
        last = now
        ended = training.done() >= 1
        if ended or training.seconds >= report:
            print(f"{training.seconds:7.0f} s  step {training.step}  {training.judge(tests):.3f} dB", flush=True)
            training.save(options.checkpoint)
            held = Path(f"{options.checkpoint}.held")
            if training.done() >= options.hold and not held.exists():
                shutil.copy(options.checkpoint, held)
            report = training.seconds + 60
            last = time.time()
        if ended:
            return None
        training.learn(*batch())


if __name__ == "__main__":
    main()
