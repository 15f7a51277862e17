"""For every line of its input, runs the embedded upsampler once in PyTorch in each of its two memory layouts, and prints
the milliseconds of the faster.

python enlarge.py SIDE THREADS
"""

import sys
import time
from pathlib import Path

import torch
from safetensors.torch import load_file

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tests" / "reference"))
from networks import Residual

side, threads = map(int, sys.argv[1:])
torch.set_num_threads(threads)
weights = load_file(HERE.parent / "models" / "residual-x4.safetensors")
width = weights["first.bias"].numel()
network = Residual(width, sum(name.startswith("a.") and name.endswith(".bias") for name in weights))
network.load_state_dict({name: tensor.float() for name, tensor in weights.items()})

LAYOUTS = [torch.contiguous_format, torch.channels_last]


def milliseconds(layout):
    model = network.to(memory_format=layout)
    image = torch.rand(1, 3, side, side).contiguous(memory_format=layout)
    start = time.perf_counter()
    model(image)
    return (time.perf_counter() - start) * 1e3


with torch.no_grad():
    for layout in LAYOUTS:
        milliseconds(layout)
    for _ in sys.stdin:
        print(min(map(milliseconds, LAYOUTS)), flush=True)
