"""Reads the latents that `srnerf-dag export latents --comfyui` wrote, as ComfyUI's `Load Latent` does, by safetensors.

python latents.py LATENTS      beside the folder latents
"""

import json
import sys
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file

source = Path(sys.argv[1]) / "latents.safetensors"
truth = load_file(source)
with safe_open(source, "np") as file:
    told = json.loads(file.metadata()["srnerf"])
files = sorted(Path("latents").iterdir())
assert [file.name for file in files] == [f"{name}.latent" for name in sorted(truth)]
for file in files:
    read = load_file(file)
    # A file without it is older, and its numbers are taken for scaled ones.
    multiplier = 1.0 if "latent_format_version_0" in read else 1 / 0.18215
    samples = read["latent_tensor"].astype(np.float32) * multiplier
    expected = truth[file.stem][None] / told["scaling_factor"]
    assert samples.shape == expected.shape and samples.shape[0] == 1
    assert np.allclose(samples, expected, rtol=1e-6), file
print(f"safetensors: {len(files)} latents of shape {samples.shape}")
