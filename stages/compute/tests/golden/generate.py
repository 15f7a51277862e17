"""Writes golden.json: what PyTorch and Pillow answer to the inputs that src/check.rs makes by the same formula.

Needs torch, numpy and pillow. Run: python generate.py
"""

import json
import pathlib

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

torch.set_num_threads(1)
golden = {}


def pattern(salt, *shape):
    """Numbers in [-1, 1) that look random and are exact in f32: a multiplicative hash of the index."""
    i = np.arange(int(np.prod(shape)), dtype=np.uint64)
    bits = ((i + np.uint64(salt * 7919)) * np.uint64(2654435761) & np.uint64(0xFFFFFFFF)) >> np.uint64(16)
    values = bits.astype(np.float64) / 32768 - 1
    return torch.tensor(values.astype(np.float32)).reshape(shape)


def save(name, tensor):
    values = [float(f"{v:.7g}") for v in np.asarray(tensor.detach(), dtype=np.float32).ravel()]
    golden[name] = {"shape": list(tensor.shape), "values": values}


def with_gradients(name, out, dy_salt, **inputs):
    """Saves the output, and for the gradient pattern(dy_salt) to it the gradients to the inputs."""
    save(name, out)
    gradients = torch.autograd.grad(out, list(inputs.values()), pattern(dy_salt, *out.shape))
    for key, gradient in zip(inputs, gradients):
        save(f"{name}.d{key}", gradient)


def leaf(salt, *shape, scale=1.0):
    return (pattern(salt, *shape) * scale).requires_grad_()


def convolutions():
    for name, stride, pad in [("plain", 1, (1, 1, 1, 1)), ("strided", 2, (0, 1, 0, 1)), ("uneven", 1, (0, 2, 1, 0))]:
        x, w, b = leaf(1, 2, 3, 9, 7), leaf(2, 4, 3, 3, 3), pattern(3, 4)
        top, bottom, left, right = pad
        y = F.conv2d(F.pad(x, (left, right, top, bottom)), w, b, stride=stride)
        with_gradients(f"conv.{name}", y, 4, x=x, w=w)


def norms():
    gamma, beta = pattern(6, 6), pattern(7, 6)
    for name, act in [("plain", lambda y: y), ("silu", F.silu)]:
        x = leaf(5, 2, 6, 5, 3)
        with_gradients(f"group_norm.{name}", act(F.group_norm(x, 3, gamma, beta, 1e-5)), 8, x=x)
    x = leaf(5, 3, 37)
    with_gradients("layer_norm", F.layer_norm(x, (37,), pattern(6, 37), pattern(7, 37), 1e-5), 8, x=x)


def attentions():
    for name, keys, causal in [("full", 67, False), ("cross", 5, False), ("causal", 67, True)]:
        q, k, v = leaf(9, 2, 67, 6, scale=4.0), leaf(10, 2, keys, 6), leaf(11, 2, keys, 6)
        heads = [t.unflatten(2, (2, 3)).transpose(1, 2) for t in (q, k, v)]
        out = F.scaled_dot_product_attention(*heads, is_causal=causal).transpose(1, 2).flatten(2)
        with_gradients(f"attention.{name}", out, 12, q=q, k=k, v=v)


def activations():
    functions = {"silu": F.silu, "gelu": F.gelu, "quick_gelu": lambda x: x * torch.sigmoid(1.702 * x)}
    for name, f in functions.items():
        x = leaf(13, 100, scale=6.0)
        with_gradients(name, f(x), 14, x=x)
    x = leaf(13, 5, 22, scale=3.0)
    a, b = x.chunk(2, dim=-1)
    with_gradients("geglu", a * F.gelu(b), 14, x=x)


def resizes():
    small, large = (9, 13), (47, 63)

    def torch_case(name, size, to, **options):
        save(f"resize.{name}", F.interpolate(pattern(15, 1, 1, *size), size=to, **options))

    torch_case("bicubic_torch_up", small, (36, 52), mode="bicubic", align_corners=False)
    torch_case("bicubic_torch_down", large, (12, 16), mode="bicubic", align_corners=False)
    torch_case("bicubic_torch_antialias_down", large, (12, 16), mode="bicubic", align_corners=False, antialias=True)
    torch_case("bilinear_up", small, (36, 52), mode="bilinear", align_corners=False)
    torch_case("bilinear_antialias_down", large, (12, 16), mode="bilinear", align_corners=False, antialias=True)
    torch_case("nearest_up", small, (36, 52), mode="nearest")
    torch_case("nearest_down", large, (12, 16), mode="nearest")
    torch_case("area_down", large, (12, 16), mode="area")

    def pillow_case(name, size, to, filter):
        image = Image.fromarray(pattern(15, *size).numpy(), mode="F")
        save(f"resize.{name}", torch.tensor(np.array(image.resize(to[::-1], filter)))[None, None])

    pillow_case("bicubic_pil_down", large, (12, 16), Image.BICUBIC)
    pillow_case("bicubic_pil_up", small, (36, 52), Image.BICUBIC)
    pillow_case("lanczos_down", large, (12, 16), Image.LANCZOS)
    pillow_case("lanczos_up", small, (36, 52), Image.LANCZOS)
    pillow_case("bilinear_pil_down", large, (12, 16), Image.BILINEAR)


def others():
    save("pad_reflect", F.pad(pattern(17, 1, 2, 4, 5), (3, 4, 2, 1), mode="reflect"))
    for name, kind, decay in [("adam", torch.optim.Adam, 0.0), ("adamw", torch.optim.AdamW, 0.1)]:
        parameter = leaf(18, 9)
        optimizer = kind([parameter], lr=0.01, betas=(0.9, 0.99), eps=1e-8, weight_decay=decay)
        for step in range(3):
            parameter.grad = pattern(19 + step, 9)
            optimizer.step()
        save(name, parameter)


for part in (convolutions, norms, attentions, activations, resizes, others):
    part()
target = pathlib.Path(__file__).with_name("golden.json")
lines = (f"{json.dumps(name)}: {json.dumps(value, separators=(',', ':'))}" for name, value in sorted(golden.items()))
target.write_text("{\n" + ",\n".join(lines) + "\n}\n")
