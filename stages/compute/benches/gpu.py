"""The operators of gpu.rs in PyTorch on CUDA: the same shapes, in f32 without TF32, as our kernels compute.

    python gpu.py     (needs torch; prints the operator and the least milliseconds of five times ten, as gpu.rs does)
"""
import time

import torch
from torch.nn import functional as F

torch.backends.cuda.matmul.allow_tf32 = False
torch.backends.cudnn.allow_tf32 = False
torch.backends.cudnn.benchmark = True


def array(*shape, gradient=False):
    """Zeros, as gpu.rs takes them: both sides are timed on the same numbers."""
    return torch.zeros(shape, device="cuda", requires_grad=gradient)


def row(name, work):
    work()
    best = float("inf")
    for _ in range(5):
        torch.cuda.synchronize()
        begin = time.perf_counter()
        for _ in range(10):
            work()
        torch.cuda.synchronize()
        best = min(best, (time.perf_counter() - begin) * 100)
    print(f"| {name} | {best:.3f} |", flush=True)


def linear(rows, k, m):
    x, w, dy = array(rows, k), array(m, k), array(rows, m)
    row(f"linear {rows}x{k}-{m}", lambda: F.linear(x, w))
    row("its gradient to the input", lambda: dy @ w)
    if min(k, m) <= 8:
        row("its gradient to the weight", lambda: dy.T @ x)


def convolution(c, o, side):
    x, w, dy = array(1, c, side, side), array(o, c, 3, 3), array(1, o, side, side)
    row(f"3x3 convolution {c}-{o}, {side}x{side}", lambda: F.conv2d(x, w, padding=1))
    row("its gradient to the input", lambda: torch.nn.grad.conv2d_input(x.shape, w, dy, padding=1))


def attention(queries, keys, heads, depth):
    q, k, v = (array(1, heads, tokens, depth, gradient=True) for tokens in (queries, keys, keys))
    with torch.no_grad():
        row(f"attention {queries}-{keys}, {heads}x{depth}", lambda: F.scaled_dot_product_attention(q, k, v))
    attended = F.scaled_dot_product_attention(q, k, v)
    row("its gradients", lambda: torch.autograd.grad(attended, (q, k, v), attended.detach(), retain_graph=True))


def others(c, side):
    x, gamma = array(1, c, side, side, gradient=True), array(c)
    with torch.no_grad():
        row(f"group norm and SiLU {c}, {side}x{side}", lambda: F.silu(F.group_norm(x, 32, gamma, gamma)))
    normed = F.silu(F.group_norm(x, 32, gamma, gamma))
    row("its gradient", lambda: torch.autograd.grad(normed, x, normed.detach(), retain_graph=True))
    tokens, wide = array(side * side, c), array(side * side, 8 * c)
    row(f"layer norm {side * side}x{c}", lambda: F.layer_norm(tokens, (c,), gamma, gamma))
    value, gate = wide.chunk(2, 1)
    row(f"GEGLU {side * side}x{8 * c}", lambda: value * F.gelu(gate))
    row(f"sum {c}, {side}x{side}", lambda: tokens + tokens)


def main():
    print(torch.cuda.get_device_name(), "torch", torch.__version__)
    for extents in ((4096, 256, 2048), (1024, 512, 4096), (1024, 2048, 512), (1024, 512, 4)):
        linear(*extents)
    for channels, outputs, side in ((256, 256, 64), (768, 256, 64), (512, 512, 32), (1024, 1024, 8)):
        convolution(channels, outputs, side)
    attention(4096, 4096, 8, 32)
    attention(1024, 77, 8, 64)
    others(256, 64)


if __name__ == "__main__":
    main()
