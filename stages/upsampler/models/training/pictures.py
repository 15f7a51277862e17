"""Training pictures beside their quarters, and crops of them drawn where bicubic fails most. Knows no network."""
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch.nn import functional as F

from network import SCALE, enlarge, reduce

# Photos are taken at these parts of their size: reduced ones are sharper for each pixel. None is smaller than LEAST.
PARTS = {True: (2, 3, 4, 6, 8), False: (1, 1.5, 2.2)}
LARGE = 2000
LEAST = 240
# Low-resolution pixels along a side of the places that crops are drawn from.
PLACE = 8


def photos(folders):
    """Every photo under `folders` at several sizes, u8 [H, W, 3]."""
    found = []
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*") if path.suffix in (".jpg", ".png"))
    for path in paths:
        image = Image.open(path).convert("RGB")
        for part in PARTS[max(image.size) > LARGE]:
            size = (int(image.width / part), int(image.height / part))
            if min(size) >= LEAST:
                found.append(np.array(image.resize(size, Image.LANCZOS)))
    return found


def pair(picture):
    """A picture, u8 [3, 4h, 4w], and its quarter in 8 bits, u8 [3, h, w]."""
    height, width = (side // SCALE * SCALE for side in picture.shape[:2])
    high = torch.from_numpy(np.ascontiguousarray(picture[:height, :width])).permute(2, 0, 1).contiguous()
    low = reduce(high[None].float())[0].round().clamp(0, 255).to(torch.uint8)
    return high, low


class Crops:
    """`batch(n)` gives (high [n, 3, 4s, 4s], low [n, 3, s, s]) from 0 to 1.

    A place is drawn by what bicubic leaves of it (the root of the mean square), so that skies and walls do not take the
    time of edges and textures.
    """

    def __init__(self, pictures, size, random):
        self.pairs = [pair(picture) for picture in pictures]
        self.size = size
        self.random = random
        errors = [self._errors(high, low) for high, low in self.pairs]
        weights = np.concatenate([(error + 1).ravel() for error in errors])
        self.ends = np.cumsum(weights / weights.sum())
        self.places = [(i, y, x) for i, error in enumerate(errors) for y, x in np.ndindex(error.shape)]

    @staticmethod
    def _errors(high, low):
        left = (high[None].float() - enlarge(low[None].float())).square().mean(1, keepdim=True)
        return F.avg_pool2d(left, SCALE * PLACE)[0, 0].sqrt().numpy()

    def _corner(self, place, side):
        at = PLACE * place + self.random.integers(0, PLACE) - self.random.integers(0, self.size)
        return int(np.clip(at, 0, side - self.size))

    def one(self):
        picture, y, x = self.places[int(np.searchsorted(self.ends, self.random.random()))]
        high, low = self.pairs[picture]
        y = self._corner(y, low.shape[1])
        x = self._corner(x, low.shape[2])
        pair = [image[:, s * y : s * (y + self.size), s * x : s * (x + self.size)] for image, s in ((high, SCALE), (low, 1))]
        for axes in ((1,), (2,)):
            if self.random.random() < 0.5:
                pair = [image.flip(axes) for image in pair]
        if self.random.random() < 0.5:
            pair = [image.transpose(1, 2) for image in pair]
        if self.random.random() < 0.3:
            order = torch.from_numpy(self.random.permutation(3))
            pair = [image[order] for image in pair]
        return pair

    def batch(self, count):
        high, low = zip(*(self.one() for _ in range(count)))
        return torch.stack(high).float() / 255, torch.stack(low).float() / 255
