"""Drawn training pictures: shapes over each other, and planes in perspective with masonry, words, checks, grain.

    drawn.py FOLDER COUNT

Unlimited and CC0. Regular patterns and glyphs are what a small network learns last from photos. Nothing here draws what the
program's test scenes draw. Knows no network.
"""
import glob
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

# Pictures are drawn this much larger and reduced by the mean, so that edges are smooth.
OVER = 3
FONTS = sorted(glob.glob("/usr/share/fonts/truetype/dejavu/*.ttf") + glob.glob("/usr/share/fonts/truetype/liberation*/*.ttf"))
# Parts of a brick by which a course is shifted against the one below, or a bond's name.
BONDS = [0.5, 0.5, 0.5, 0.5, 0.33, 0.25, 0, "english", "flemish", "loose"]
WORDS = "the quick brown fox jumps over lazy dogs ABC KLM xyz 0123456789 & photo river stone glass open EXIT 42 No. 7".split()


def colour(random):
    """Any colour at all."""
    return tuple(int(value) for value in random.integers(0, 256, 3))


def muted(random):
    """A grey with a little colour."""
    grey = random.uniform(20, 235)
    return tuple(int(np.clip(grey + shift, 0, 255)) for shift in random.normal(0, 30, 3))


def either(random):
    return muted(random) if random.random() < 0.65 else colour(random)


def two_tone(mask, front, back):
    """Colours `front` where `mask` [n, n] is 1 and `back` where it is 0."""
    mask = mask[..., None]
    return Image.fromarray((np.array(front) * (1 - mask) + np.array(back) * mask).astype(np.uint8))


def smooth_noise(random, side, rows, columns):
    """Noise of unit variance that varies over `rows` x `columns` places. [side, side]"""
    coarse = random.normal(0, 1, (max(2, int(rows)), max(2, int(columns)))).astype(np.float32)
    return np.array(Image.fromarray(coarse).resize((side, side), Image.BICUBIC))


def shaded(tone, random, light, hue):
    """The colour, lighter or darker by `light` and each channel by `hue`, which are standard deviations."""
    shift = light * random.normal() + hue * random.normal(0, 1, 3)
    return tuple(int(np.clip(value + by, 0, 255)) for value, by in zip(tone, shift))


def course(random, bond, row, length):
    """Where a course begins, and the lengths of its bricks, which repeat."""
    half = length / 2
    if bond == "english":
        return (0, [length]) if row % 2 else (half / 2, [half])
    if bond == "flemish":
        return (0.75 * length if row % 2 else 0), [length, half]
    if bond == "loose":
        return random.uniform(0, length), [length * random.uniform(0.6, 1.4) for _ in range(5)]
    return row * bond % 1 * length, [length]


def joints(random, brick):
    """A colour between bricks: three times in four a grey that is lighter or darker than they are."""
    between = either(random)
    if random.random() < 0.75:
        grey = np.mean(brick) + random.choice([-1, 1, 1]) * random.uniform(30, 130)
        between = shaded((grey, grey, grey), random, 0, 8)
    return between


def lay(draw, top, bottom, start, lengths, joint, shade):
    """Draws a course of bricks from side to side."""
    x = start - sum(lengths)
    count = 0
    while x < draw.im.size[0]:
        length = lengths[count % len(lengths)]
        draw.rectangle((x, top, x + max(1, length - joint - 1), bottom - joint - 1), fill=shade())
        x += length
        count += 1


def masonry(random, side):
    """Bricks in courses, each with a shade of its own. Small bricks are as likely as large ones."""
    height = OVER * math.exp(random.uniform(math.log(4), math.log(26)))
    length = height * random.uniform(1.4, 4.2)
    joint = max(OVER * 0.4, height * random.uniform(0.05, 0.24))
    bond = BONDS[int(random.integers(len(BONDS)))]
    brick = either(random)
    between = joints(random, brick)
    light = random.uniform(2, 32)
    hue = random.uniform(0, 10)
    image = Image.new("RGB", (side, side), between)
    draw = ImageDraw.Draw(image)
    for row in range(int(side / height) + 1):
        start, lengths = course(random, bond, row, length)
        lay(draw, row * height, row * height + height, start, lengths, joint, lambda: shaded(brick, random, light, hue))
    rough = smooth_noise(random, side, side / 3, side / 3) * random.uniform(0, 14)
    return Image.fromarray(np.clip(np.array(image) + rough[..., None], 0, 255).astype(np.uint8))


def words(random, side):
    """Lines of words in several sizes and fonts."""
    image = Image.new("RGB", (side, side), either(random))
    draw = ImageDraw.Draw(image)
    ink = either(random)
    y = 0
    while y < side:
        size = int(OVER * random.choice([6, 7, 8, 10, 12, 16, 24, 36]))
        line = " ".join(str(word) for word in random.choice(WORDS, 14))
        line = line.upper() if random.random() < 0.5 else line
        font = ImageFont.truetype(FONTS[int(random.integers(len(FONTS)))], size)
        draw.text((int(random.integers(0, 40)), y), line, fill=ink, font=font)
        y += int(size * random.uniform(1.1, 1.6))
    return image


def grain(random, side):
    """Streaks along one axis, as in wood or brushed metal."""
    streaks = smooth_noise(random, side, side / random.uniform(3, 20), side / random.uniform(20, 200))
    fine = smooth_noise(random, side, side / 4, side / 4)
    value = np.array(muted(random)) + (streaks * random.uniform(8, 30) + fine * random.uniform(0, 10))[..., None]
    return Image.fromarray(np.clip(value, 0, 255).astype(np.uint8))


def pattern(random, side):
    """Checks, stripes, rays, a lattice or rings, of two colours."""
    y, x = np.mgrid[0:side, 0:side].astype(np.float32)
    period = OVER * float(random.uniform(2, 16))
    kind = random.random()
    if kind < 0.3:
        mask = (x // period + y // period) % 2
    elif kind < 0.6:
        angle = random.uniform(0, math.pi)
        along = x * math.cos(angle) + y * math.sin(angle)
        mask = (along / period % 1 < random.uniform(0.2, 0.8)).astype(np.float32)
    elif kind < 0.75:
        angle = np.arctan2(y - side / 2, x - side / 2)
        mask = (angle * int(random.integers(6, 40)) / (2 * math.pi) % 1 < 0.5).astype(np.float32)
    elif kind < 0.9:
        line = random.uniform(0.05, 0.3)
        mask = ((x / period % 1 < line) | (y / period % 1 < line)).astype(np.float32)
    else:
        radius = np.hypot(x - side * random.uniform(0, 1), y - side * random.uniform(0, 1))
        mask = 0.5 + 0.5 * np.sin(2 * math.pi * radius / period)
    return two_tone(mask, colour(random), colour(random))


def surface(random, side):
    kind = random.random()
    if kind < 0.5:
        return masonry(random, side)
    if kind < 0.7:
        return words(random, side)
    return grain(random, side) if kind < 0.82 else pattern(random, side)


def tilted(image, random):
    """The picture seen at a slant, and turned."""
    side = image.size[0]
    slack = side * random.uniform(0, 0.3)
    near, far = (lambda: random.uniform(0, slack)), (lambda: side - random.uniform(0, slack))
    corners = [(near(), near()), (far(), near()), (far(), far()), (near(), far())]
    rows, values = [], []
    for (u, v), (x, y) in zip([(0, 0), (side, 0), (side, side), (0, side)], corners):
        rows += [[u, v, 1, 0, 0, 0, -x * u, -x * v], [0, 0, 0, u, v, 1, -y * u, -y * v]]
        values += [x, y]
    image = image.transform((side, side), Image.PERSPECTIVE, np.linalg.solve(rows, values), Image.BICUBIC)
    # Walls and pages mostly stand nearly upright.
    kind = random.random()
    angle = random.normal(0, 5) if kind < 0.45 else random.uniform(-30, 30) if kind < 0.75 else random.uniform(0, 360)
    margin = side // 4
    padded = Image.fromarray(np.pad(np.array(image), ((margin, margin), (margin, margin), (0, 0)), mode="reflect"))
    return padded.rotate(angle, Image.BICUBIC).crop((margin, margin, margin + side, margin + side))


def paste(canvas, image, random, box):
    """Puts `image` somewhere, cut to an ellipse or a rectangle and turned."""
    mask = Image.new("L", image.size, 0)
    shape = ImageDraw.Draw(mask).ellipse if random.random() < 0.4 else ImageDraw.Draw(mask).rectangle
    shape((2, 2, image.size[0] - 3, image.size[1] - 3), fill=255)
    angle = random.uniform(-25, 25)
    turned = [layer.rotate(angle, Image.BICUBIC, expand=True) for layer in (image, mask)]
    place = tuple(int(value) for value in random.integers(-box // 3, canvas.size[0] - box // 2, 2))
    canvas.paste(turned[0], place, turned[1])


def planes(random, side):
    """A slanted surface, a few others before it, thin lines, uneven light and a little noise. u8 [side, side, 3]"""
    large = side * OVER
    canvas = tilted(surface(random, large), random)
    for _ in range(int(random.integers(2, 9))):
        box = int(large * random.uniform(0.1, 0.5))
        plain = Image.new("RGB", (box, box), muted(random))
        image = plain if random.random() < 0.4 else tilted(surface(random, large), random).crop((0, 0, box, box // 2 + 4))
        paste(canvas, image, random, box)
    draw = ImageDraw.Draw(canvas)
    for _ in range(int(random.integers(0, 14))):
        ends = [float(value) for value in random.uniform(0, large, 4)]
        draw.line(ends, fill=muted(random), width=max(1, int(OVER * random.uniform(0.5, 3))))
    light = np.array(Image.fromarray(random.uniform(0.55, 1.15, (4, 4)).astype(np.float32)).resize((side, side), Image.BICUBIC))
    noise = random.normal(0, random.uniform(0, 2), (side, side, 3))
    value = np.array(canvas.resize((side, side), Image.BOX)) * light[..., None] + noise
    return np.clip(value + 0.5, 0, 255).astype(np.uint8)


def leaves(random, side):
    """Dead leaves: shapes whose sizes follow a power law, one over the other. u8 [side, side, 3]"""
    large = side * OVER
    canvas = Image.new("RGB", (large, large), colour(random))
    least = random.uniform(0.02, 0.06)
    for _ in range(int(random.integers(60, 260))):
        box = 2 * int(min(large * least * (random.pareto(1.6) + 0.5), large * 0.6)) + 8
        image = Image.new("RGB", (box, box), colour(random)) if random.random() < 0.45 else pattern(random, box)
        paste(canvas, image, random, box)
    return np.array(canvas.resize((side, side), Image.BOX))


def draw(folder, index, side=352, seed=11):
    """Writes one picture: two of planes, then one of leaves."""
    random = np.random.default_rng([seed, index])
    drawn = leaves(random, side) if index % 3 == 2 else planes(random, side)
    Image.fromarray(drawn).save(folder / f"{index:04}.png")


def main(folder, count):
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor() as pool:
        list(pool.map(draw, [folder] * count, range(count)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
