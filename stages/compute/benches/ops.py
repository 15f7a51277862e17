"""Milliseconds of PyTorch on the shapes of ops.rs, under the same names. Run: python ops.py [part of a name ...]

The first line says versions and threads, which are RAYON_NUM_THREADS, or 2.
"""

import os
import sys
import time

import torch
import torch.nn.functional as F

torch.set_num_threads(int(os.environ.get("RAYON_NUM_THREADS", "2")))
print(f"PyTorch {torch.__version__}, f32, {torch.get_num_threads()} threads", flush=True)
wanted = sys.argv[1:]


def clock(name, make):
    """The least time of what `make` makes, which is not made unless it is wanted."""
    if wanted and not any(part in name for part in wanted):
        return
    work = make()
    work()
    start, times = time.perf_counter(), []
    while len(times) < 3 or (time.perf_counter() - start < 0.25 and len(times) < 100):
        begin = time.perf_counter()
        work()
        times.append((time.perf_counter() - begin) * 1e3)
    print(f"{name}\t{min(times):.4f}", flush=True)


def backward(f, *inputs):
    """One backward pass alone to `inputs`, the graph being kept."""
    leaves = [x.detach().requires_grad_() for x in inputs]
    out = f(*leaves)
    dy = torch.randn_like(out)
    return lambda: torch.autograd.grad(out, leaves, dy, retain_graph=True)


def linear(tokens, k, m):
    x, w = torch.randn(tokens, k), torch.randn(m, k)
    name = f"linear {tokens}x{k}-{m}"
    clock(f"{name} forward", lambda: lambda: F.linear(x, w))
    clock(f"{name} input", lambda: backward(lambda x: F.linear(x, w), x))
    if min(k, m) <= 8:
        clock(f"{name} weight", lambda: backward(lambda w: F.linear(x, w), w))


def conv(batch, channels, size, kernel, stride):
    c, o = channels
    x, weight = torch.randn(batch, c, size, size), torch.randn(o, c, kernel, kernel)

    def run(x, weight):
        if stride == 1:
            return F.conv2d(x, weight, padding=kernel // 2)
        return F.conv2d(F.pad(x, (0, 1, 0, 1)), weight, stride=stride)

    name = f"conv{kernel}s{stride} {batch}x{c}-{o} {size}x{size}"
    clock(f"{name} forward", lambda: lambda: run(x, weight))
    clock(f"{name} input", lambda: backward(lambda x: run(x, weight), x))
    if c * o <= 1 << 14:
        clock(f"{name} weight", lambda: backward(lambda weight: run(x, weight), weight))


def attention(batch, tokens, heads):
    (queries, keys), (heads, depth) = tokens, heads
    q = torch.randn(batch, heads, queries, depth)
    k, v = (torch.randn(batch, heads, keys, depth) for _ in range(2))
    name = f"attention {batch}x{queries}-{keys} {heads}x{depth}"
    clock(f"{name} forward", lambda: lambda: F.scaled_dot_product_attention(q, k, v))
    clock(f"{name} backward", lambda: backward(F.scaled_dot_product_attention, q, k, v))


def norms(batch, c, size, groups):
    x, gamma, beta = torch.randn(batch, c, size, size), torch.randn(c), torch.randn(c)
    name = f"{batch}x{c} {size}x{size}"

    def group(x):
        return F.silu(F.group_norm(x, groups, gamma, beta))

    def layer(x):
        return F.layer_norm(x, (c,), gamma, beta)

    clock(f"group_norm_silu {name} forward", lambda: lambda: group(x))
    clock(f"group_norm_silu {name} backward", lambda: backward(group, x))
    tokens = x.reshape(batch * size * size, c)
    clock(f"layer_norm {name} forward", lambda: lambda: layer(tokens))
    clock(f"layer_norm {name} backward", lambda: backward(layer, tokens))


def maps():
    x, y = torch.randn(1024, 4096), torch.randn(1024, 4096)

    def geglu(x):
        a, b = x.chunk(2, dim=-1)
        return a * F.gelu(b)

    clock("map: add 1024x4096", lambda: lambda: x + y)
    clock("map: silu 1024x4096", lambda: lambda: F.silu(x))
    clock("map: gelu 1024x4096", lambda: lambda: F.gelu(x))
    clock("map: geglu 1024x4096 forward", lambda: lambda: geglu(x))
    clock("map: geglu 1024x4096 backward", lambda: backward(geglu, x))
    image, photo = torch.randn(1, 256, 64, 64), torch.randn(1, 3, 192, 256)
    clock("map: nchw_to_tokens 1x256 64x64", lambda: lambda: image.flatten(2).transpose(1, 2).contiguous())
    clock("map: concat 1x256+256 64x64", lambda: lambda: torch.cat([image, image], 1))
    clock("map: upsample_nearest 1x256 64x64", lambda: lambda: F.interpolate(image, scale_factor=2))
    clock("map: bicubic 192x256-768x1024", lambda: lambda: F.interpolate(photo, size=(768, 1024), mode="bicubic"))
    clock("map: bicubic 192x256-48x64", lambda: lambda: F.interpolate(photo, size=(48, 64), mode="bicubic", antialias=True))


a, b = torch.randn(1024, 1024), torch.randn(1024, 1024)
clock("matmul 1024x1024x1024", lambda: lambda: a @ b)
for extents in [(1024, 512, 4096), (1024, 2048, 512), (64, 1024, 8192), (1024, 512, 4), (1024, 4, 512)]:
    linear(*extents)
for extents in [(1024, 96, 768), (256, 128, 128), (1024, 96, 4)]:
    linear(*extents)
for channels, size in [((256, 256), 64), ((768, 256), 64), ((512, 512), 32), ((512, 512), 16), ((1024, 1024), 8)]:
    conv(1, channels, size, 3, 1)
conv(2, (1024, 1024), 8, 3, 1)
conv(1, (256, 256), 64, 3, 2)
conv(1, (768, 256), 64, 1, 1)
for channels, size in [((19, 64), 32), ((64, 64), 32), ((96, 96), 16), ((128, 128), 8)]:
    conv(4, channels, size, 3, 1)
conv(4, (64, 64), 32, 3, 2)
conv(1, (512, 512), 64, 3, 1)
conv(1, (128, 128), 256, 3, 1)
conv(4, (32, 32), 128, 3, 1)
conv(1, (128, 3), 256, 3, 1)
attention(1, (4096, 4096), (1, 512))
attention(1, (4096, 4096), (8, 32))
attention(1, (1024, 77), (8, 64))
attention(4, (256, 256), (4, 24))
norms(1, 256, 64, 32)
norms(1, 128, 256, 32)
norms(4, 64, 32, 16)
maps()
