"""Milliseconds of PyTorch on the shapes of ops.rs, under the same names: median and least. Run: python ops.py [part of a name ...]

The number of threads is OMP_NUM_THREADS, or 2.
"""

import os
import sys
import time

import torch
import torch.nn.functional as F

torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "2")))
wanted = sys.argv[1:]


def clock(name, work):
    if wanted and not any(part in name for part in wanted):
        return
    work()
    start, times = time.perf_counter(), []
    while len(times) < 3 or (time.perf_counter() - start < 0.5 and len(times) < 100):
        begin = time.perf_counter()
        work()
        times.append((time.perf_counter() - begin) * 1e3)
    times.sort()
    print(f"{name} {times[len(times) // 2]:.3f} {times[0]:.3f}", flush=True)


def backward(out, inputs, dy):
    """The time of one backward pass alone, the graph being kept."""
    return lambda: torch.autograd.grad(out, inputs, dy, retain_graph=True)


def products():
    for m, k, n in [(1024, 1024, 1024), (4096, 320, 1280), (3072, 96, 768), (3072, 128, 128)]:
        a, b, w = torch.randn(m, k), torch.randn(k, n), torch.randn(n, k)
        clock(f"matmul_{m}x{k}x{n}", lambda: a @ b)
        clock(f"linear_{m}x{k}x{n}", lambda: F.linear(a, w))


def convolution(batch, channels, size, kernel, stride):
    (c, o), (h, w) = channels, size
    x, weight = torch.randn(batch, c, h, w), torch.randn(o, c, kernel, kernel)
    if stride == 1:
        def run(x, weight):
            return F.conv2d(x, weight, padding=kernel // 2)
    else:
        def run(x, weight):
            return F.conv2d(F.pad(x, (0, 1, 0, 1)), weight, stride=stride)
    name = f"conv{kernel}s{stride}_{batch}x{c}-{o}_{w}x{h}"
    clock(f"{name}_forward", lambda: run(x, weight))
    dy = run(x, weight)
    for which, leaf in (("input", x), ("weight", weight)):
        x.requires_grad_(which == "input")
        weight.requires_grad_(which == "weight")
        clock(f"{name}_{which}", backward(run(x, weight), leaf, dy))


def attentions(batch, tokens, keys, heads, depth):
    q = torch.randn(batch, heads, tokens, depth)
    k, v = (torch.randn(batch, heads, keys, depth) for _ in range(2))
    name = f"attention_{batch}x{tokens}-{keys}_{heads}x{depth}"
    clock(f"{name}_forward", lambda: F.scaled_dot_product_attention(q, k, v))
    leaves = [t.requires_grad_() for t in (q, k, v)]
    clock(f"{name}_backward", backward(F.scaled_dot_product_attention(*leaves), leaves, torch.randn_like(q)))


def norms(n, c, h, w):
    x, dy, gamma, beta = torch.randn(n, c, h, w), torch.randn(n, c, h, w), torch.randn(c), torch.randn(c)
    name = f"{n}x{c}_{w}x{h}"
    clock(f"group_norm_silu_{name}_forward", lambda: F.silu(F.group_norm(x, 32, gamma, beta)))
    x.requires_grad_()
    clock(f"group_norm_silu_{name}_backward", backward(F.silu(F.group_norm(x, 32, gamma, beta)), x, dy))
    x, dy = x.detach().reshape(n * h * w, c), dy.reshape(n * h * w, c)
    clock(f"layer_norm_{name}_forward", lambda: F.layer_norm(x, (c,), gamma, beta))
    x.requires_grad_()
    clock(f"layer_norm_{name}_backward", backward(F.layer_norm(x, (c,), gamma, beta), x, dy))


def maps():
    x, y = torch.randn(3072, 1024), torch.randn(3072, 1024)
    clock("add", lambda: x + y)
    clock("silu", lambda: F.silu(x))
    clock("gelu", lambda: F.gelu(x))

    def geglu():
        a, b = x.chunk(2, dim=-1)
        return a * F.gelu(b)

    clock("geglu", geglu)
    image = torch.randn(1, 128, 128, 128)
    clock("nchw_to_tokens", lambda: image.flatten(2).transpose(1, 2).contiguous())
    clock("upsample_nearest", lambda: F.interpolate(image, scale_factor=2))
    photo = torch.randn(1, 3, 192, 256)
    clock("bicubic_up", lambda: F.interpolate(photo, size=(768, 1024), mode="bicubic"))
    clock("bicubic_down", lambda: F.interpolate(photo, size=(48, 64), mode="bicubic", antialias=True))


products()
convolution(1, (256, 256), (64, 64), 3, 1)
convolution(2, (96, 96), (48, 64), 3, 1)
convolution(1, (32, 32), (192, 256), 3, 1)
convolution(1, (96, 96), (48, 64), 3, 2)
convolution(2, (192, 128), (24, 32), 1, 1)
attentions(1, 4096, 4096, 8, 32)
attentions(2, 768, 768, 8, 16)
attentions(2, 3072, 77, 8, 16)
norms(1, 256, 128, 128)
norms(2, 96, 48, 64)
maps()
