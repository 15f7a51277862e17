"""The embedded upsampler in PyTorch: a residual network at the low resolution. Knows no training."""
import torch
from torch import nn
from torch.nn import functional as F

SCALE = 4


def enlarge(image):
    """Bicubic enlargement with a = -0.75, what the network adds its residual to. [N, 3, h, w] -> [N, 3, 4h, 4w]"""
    return F.interpolate(image, scale_factor=SCALE, mode="bicubic")


def reduce(image):
    """The filter that makes low-resolution photos: antialiased bicubic with a = -0.5, as PIL's."""
    return F.interpolate(image, scale_factor=1 / SCALE, mode="bicubic", antialias=True)


class Residual(nn.Module):
    """`pairs` residual pairs of 3x3 convolutions with `width` channels. [N, 3, h, w] from 0 to 1 -> [N, 3, 4h, 4w]"""

    def __init__(self, width=64, pairs=8):
        super().__init__()

        def conv(inputs, outputs):
            return nn.Conv2d(inputs, outputs, 3, padding=1)

        self.first = conv(3, width)
        self.a = nn.ModuleList([conv(width, width) for _ in range(pairs)])
        self.b = nn.ModuleList([conv(width, width) for _ in range(pairs)])
        self.after = conv(width, width)
        self.last = conv(width, 3 * SCALE * SCALE)
        self._start()

    def _start(self):
        """Training starts at bicubic: the last layer is zero. Pairs start near the identity."""
        for layer in [*self.a, *self.b, self.after]:
            nn.init.kaiming_normal_(layer.weight)
            nn.init.zeros_(layer.bias)
        for layer in self.b:
            layer.weight.data.mul_(0.1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, image):
        features = self.first((image - 0.45) * 4)
        h = features
        for a, b in zip(self.a, self.b):
            h = h + b(F.relu(a(h), inplace=True))
        detail = self.last(features + self.after(h))
        return enlarge(image) + 0.25 * F.pixel_shuffle(detail, SCALE)


class Muon(torch.optim.Optimizer):
    """Momentum whose matrices are made nearly orthogonal by five Newton-Schulz steps (Jordan et al. 2024)."""

    def __init__(self, parameters, lr, momentum=0.95):
        super().__init__(parameters, {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self):
        for group in self.param_groups:
            shapes = {}
            for parameter in group["params"]:
                shapes.setdefault(parameter.shape, []).append(parameter)
            for parameters in shapes.values():
                self._move(parameters, group["lr"], group["momentum"])

    def _move(self, parameters, rate, momentum):
        """Moves parameters of one shape, which are one batch of matrices."""
        gradients = [parameter.grad for parameter in parameters]
        means = [self.state[p].setdefault("mean", torch.zeros_like(p)) for p in parameters]
        torch._foreach_lerp_(means, gradients, 1 - momentum)
        x = torch.stack([gradient.lerp(mean, momentum).flatten(1) for gradient, mean in zip(gradients, means)])
        x = x / (x.norm(dim=(1, 2), keepdim=True) + 1e-12)
        for _ in range(5):
            gram = x @ x.mT
            x = 3.4445 * x + (-4.7750 * gram + 2.0315 * gram @ gram) @ x
        # A matrix with more rows than columns would move less than others.
        stretch = max(1, x.shape[1] / x.shape[2]) ** 0.5
        torch._foreach_add_(parameters, list(x.view(-1, *parameters[0].shape)), alpha=-rate * stretch)
