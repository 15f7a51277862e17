"""Writes photos at random sizes and turned by random angles, so that each is seen on many grids of pixels.

    turned.py OUT PHOTO...     (OUT/NAME_0.png and so on; photos of full resolution)
"""
import math
import random
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from PIL import Image

COUNT = 3
# The longer side of what is written, and by how much a photo is reduced at least: large photos are blurred at the pixel.
SIDES = (420, 1100)
LEAST_PART = 1.8
LEAST_SIDE = 240


def inner_square(image, angle):
    """The largest upright square in the middle of the photo turned by `angle` degrees."""
    turn = math.radians(abs(angle))
    side = int(min(image.size) / (math.sin(turn) + math.cos(turn)))
    x, y = ((extent - side) // 2 for extent in image.size)
    return image.rotate(angle, Image.BICUBIC).crop((x, y, x + side, y + side))


def turned(out, path):
    random.seed(path.name)
    photo = Image.open(path).convert("RGB")
    for i in range(COUNT):
        angle = random.choice([0, 0, random.uniform(-45, 45)])
        image = inner_square(photo, angle) if angle else photo
        part = max(LEAST_PART, max(image.size) / random.uniform(*SIDES))
        image = image.resize((int(image.width / part), int(image.height / part)), Image.LANCZOS)
        if min(image.size) >= LEAST_SIDE:
            image.save(out / f"{path.stem}_{i}.png")


def main(out, paths):
    out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor() as pool:
        list(pool.map(partial(turned, out), paths))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(path) for path in sys.argv[2:]])
