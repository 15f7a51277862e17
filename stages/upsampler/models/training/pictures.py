"""Training pictures beside their quarters, and crops of them drawn where bicubic fails most. Knows no network.

All pictures lie on the training device as two long rows of pixels, so that a batch is two look-ups whatever the device.
"""
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch.nn import functional as F

from network import SCALE, enlarge, reduce

# Photos are taken at these parts of their size: reduced ones are sharper for each pixel. None is smaller than LEAST.
PARTS = {True: (2, 3, 4, 6, 8), False: (1, 1.5, 2.2, 3.2)}
LARGE = 2000
LEAST = 240
# Low-resolution pixels along a side of the places that crops are drawn from.
PLACE = 8


def sizes(path):
    """A photo at several sizes, u8 [H, W, 3] each."""
    image = Image.open(path).convert("RGB")
    wanted = [(int(image.width / part), int(image.height / part)) for part in PARTS[max(image.size) > LARGE]]
    return [np.array(image.resize(size, Image.LANCZOS)) for size in wanted if min(size) >= LEAST]


def photos(folders):
    """Every photo under `folders` at several sizes, u8 [H, W, 3]."""
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*") if path.suffix in (".jpg", ".png"))
    with ThreadPoolExecutor() as pool:
        return [picture for found in pool.map(sizes, paths) for picture in found]


def pair(picture, device):
    """A picture, u8 [4h, 4w, 3], and its quarter in 8 bits, u8 [h, w, 3]."""
    height, width = (side // SCALE * SCALE for side in picture.shape[:2])
    high = torch.from_numpy(np.ascontiguousarray(picture[:height, :width])).to(device)
    low = reduce(high.permute(2, 0, 1)[None].float())[0].round().clamp(0, 255).to(torch.uint8)
    return high, low.permute(1, 2, 0).contiguous()


def left_by_bicubic(high, low):
    """The root of the mean square of what bicubic leaves of a picture, by places. [h/8, w/8]"""
    high, low = (image.permute(2, 0, 1)[None].float() for image in (high, low))
    squares = (high - enlarge(low)).square().mean(1, keepdim=True)
    return F.avg_pool2d(squares, SCALE * PLACE)[0, 0].sqrt()


class Crops:
    """`batch(n)` gives (high [n, 3, 4s, 4s], low [n, 3, s, s]) from 0 to 1, channels last.

    A place is drawn by what bicubic leaves of it, so that skies and walls do not take the time of edges and textures.
    """

    def __init__(self, pictures, size, device, seed):
        self.size = size
        self.device = device
        self.random = torch.Generator(device).manual_seed(seed)
        pairs = [pair(picture, device) for picture in pictures]
        errors = [left_by_bicubic(high, low) + 1 for high, low in pairs]
        weights = torch.cat([error.flatten() for error in errors]).double()
        self.ends = weights.cumsum(0) / weights.sum()
        # Where each place lies: its picture, row and column.
        self.places = torch.cat([
            torch.cat([torch.full_like(at[:, :1], index), at], 1)
            for index, at in enumerate(torch.ones_like(error).nonzero() for error in errors)
        ])
        self.sides = torch.tensor([low.shape[:2] for _, low in pairs], device=device)
        self.starts = (self.sides.prod(1).cumsum(0) - self.sides.prod(1))
        self.high = torch.cat([high.flatten(0, 1) for high, _ in pairs])
        self.low = torch.cat([low.flatten(0, 1) for _, low in pairs])

    def _uniform(self, *shape):
        return torch.rand(shape, generator=self.random, device=self.device)

    def _corners(self, count):
        """Pictures [n], and the low-resolution rows and columns at which crops begin [n, 2]."""
        drawn = torch.rand(count, generator=self.random, device=self.device, dtype=torch.float64)
        place = self.places[torch.searchsorted(self.ends, drawn).clamp(max=len(self.places) - 1)]
        picture = place[:, 0]
        shift = (self._uniform(count, 2) * PLACE).long() - (self._uniform(count, 2) * self.size).long()
        most = self.sides[picture] - self.size
        return picture, (PLACE * place[:, 1:] + shift).clamp(min=0).minimum(most)

    def _look_up(self, pixels, scale, picture, corner, flips):
        """Crops of `scale` times the low resolution, flipped and turned. u8 [n, scale*s, scale*s, 3]"""
        side = scale * self.size
        steps = torch.arange(side, device=self.device).expand(len(picture), side)
        rows = torch.where(flips[:, :1], side - 1 - steps, steps)[:, :, None]
        columns = torch.where(flips[:, 1:2], side - 1 - steps, steps)[:, None, :]
        turned = flips[:, 2, None, None]
        y = torch.where(turned, columns, rows) + scale * corner[:, 0, None, None]
        x = torch.where(turned, rows, columns) + scale * corner[:, 1, None, None]
        width = scale * self.sides[picture, 1]
        start = scale * scale * self.starts[picture]
        return pixels[start[:, None, None] + y * width[:, None, None] + x]

    def batch(self, count):
        picture, corner = self._corners(count)
        flips = self._uniform(count, 3) < 0.5
        # Three in ten crops have their colours exchanged.
        kept = torch.arange(3, device=self.device).expand(count, 3)
        order = torch.where(self._uniform(count, 1) < 0.3, self._uniform(count, 3).argsort(1), kept)[:, None, None, :]
        crops = [self._look_up(*which, picture, corner, flips) for which in ((self.high, SCALE), (self.low, 1))]
        return [(crop.gather(3, order.expand(crop.shape)).float() / 255).permute(0, 3, 1, 2) for crop in crops]
