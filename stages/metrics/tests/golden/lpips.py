"""Writes lpips.json: what the packages `lpips` and `stlpips-pytorch` say of two pictures with made-up weights.

    python lpips.py FOLDER

needs torch, torchvision, safetensors, lpips and stlpips-pytorch (with IPython and torchsummary). Trained trunks are large and not ours
to pass on, so every tensor is filled by the rule of `filled`; the test fills the same names and shapes by the same rule.
The trained weights that stlpips-pytorch carries are written to FOLDER as safetensors, and their distances beside the others:
a test compares them where SRNERF_TEST_STLPIPS names the folder.
"""

import json
import sys
import types
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from pictures import degraded, texture

HERE = Path(__file__).parent
sys.path.remove(str(HERE))  # or this script would be taken for the package
import lpips  # noqa: E402

# Only its command-line helper wants it.
sys.modules.setdefault("torchsummary", types.SimpleNamespace(summary=None))
from stlpips_pytorch import stlpips  # noqa: E402


def filled(number, name, shape):
    """Whole numbers first, so that every language agrees to the last bit."""
    i = np.arange(int(np.prod(shape)), dtype=np.int64)
    part = (i * i % 10007 * 7919 + i * 104729 + number * 1299709) % 10007 / 10007.0
    if name.startswith("lin"):
        values = part
    elif name.endswith("bias"):
        values = (part - 0.5) * 0.2
    else:
        values = (part - 0.5) * np.sqrt(24.0 / np.prod(shape[1:]))
    return torch.from_numpy(values.astype(np.float32).reshape(shape))


def wanted(name):
    return not name.startswith(("lins.", "scaling_layer.")) and not name.endswith(".filt")


def image(rgb8):
    return torch.from_numpy(rgb8.astype(np.float32) / 255).permute(2, 0, 1)[None] * 2 - 1


def state(model):
    return {name: value for name, value in sorted(model.state_dict().items()) if wanted(name)}


def main():
    truth = texture(96, 80)
    pair = image(truth), image(degraded(truth))
    models = {f"lpips_{net}": lpips.LPIPS(net=net, pnet_rand=True, pretrained=False, verbose=False)
              for net in ("alex", "vgg", "squeeze")}
    models |= {f"stlpips_{net}": stlpips.LPIPS(net=net, variant="shift_tolerant", pretrained=True, verbose=False)
               for net in ("alex", "vgg")}
    golden = {}
    for name, model in models.items():
        trained = {}
        if name.startswith("stlpips"):
            save_file({k: v.clone() for k, v in state(model).items()}, f"{sys.argv[1]}/{name}.safetensors")
            with torch.no_grad():
                trained = {"trained": model(*pair).item()}
        tensors = state(model)
        made = {key: filled(number, key, list(value.shape)) for number, (key, value) in enumerate(tensors.items())}
        model.load_state_dict(made, strict=False)
        with torch.no_grad():
            golden[name] = {
                "tensors": [[key, list(value.shape)] for key, value in tensors.items()],
                "distance": model(*pair).item(),
                **trained,
            }
    (HERE / "lpips.json").write_text(json.dumps(golden, indent=1) + "\n")


main()
