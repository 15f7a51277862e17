"""Prints the median time in milliseconds that PyTorch takes with the embedded upsampler, in the faster of its two memory
layouts, with as many threads as there are cores.

python enlarge.py SIDE RUNS
"""

import os
import statistics
import sys
import time
from pathlib import Path

import torch
from safetensors.torch import load_file

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tests" / "reference"))
from networks import Residual

side, runs = map(int, sys.argv[1:])
torch.set_num_threads(len(os.sched_getaffinity(0)))
weights = load_file(HERE.parent / "models" / "residual-x4.safetensors")
width = weights["first.bias"].numel()
network = Residual(width, sum(name.startswith("a.") and name.endswith(".bias") for name in weights))
network.load_state_dict({name: tensor.float() for name, tensor in weights.items()})


def median(layout):
    model, image, times = network.to(memory_format=layout), torch.rand(1, 3, side, side).contiguous(memory_format=layout), []
    for _ in range(runs + 1):
        start = time.perf_counter()
        model(image)
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times[1:])


with torch.no_grad():
    print(min(median(layout) for layout in [torch.contiguous_format, torch.channels_last]))
