"""The pictures that the golden numbers are of, and their degraded versions; the test makes the same ones."""

from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).parent


def read(name):
    return np.asarray(Image.open(HERE / name).convert("RGB"))


def texture(width, height):
    """Integer arithmetic, so that every language agrees: waves with noise, and a flat quarter."""
    y, x, c = np.mgrid[0:height, 0:width, 0:3]
    noise = (x * 7919 + y * 104729 + c * 1299709 + x * y * 31) % 97
    value = (x * x // 64 + y * 3 + c * 40) % 128 + noise
    return np.where((x < width // 2) & (y < height // 2), 200, value).astype(np.uint8)


def degraded(image):
    """Each row mixed with its left neighbour's, darkened and coarsened, in integers."""
    wide = image.astype(np.int64)
    mixed = (wide + np.roll(wide, 1, axis=1)) // 2
    return (mixed * 9 // 10 // 8 * 8).astype(np.uint8)


def pictures():
    return {"skyline": read("skyline.png"), "portrait": read("portrait.png"), "texture": texture(300, 200)}
