"""Writes perceptual.json: what NVIDIA's FLIP and libjxl's SSIMULACRA2 say of the pictures beside this script.

    python perceptual.py ssimulacra2

needs numpy, Pillow and flip-evaluator; its argument is the program of that name, which libjxl 0.11 has (Debian's
libjxl-devtools). The pictures and their degraded versions are those of pictures.py.

libjxl computes in single precision, and where a picture is flat its variances are mostly rounding. So the same formulas stand in
double_precision.py once more. How far libjxl is to be trusted it says itself: a picture that halves evenly five times has one score by
the formulas, however it is turned and mirrored, and eight by libjxl.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import flip_evaluator
import numpy as np
from PIL import Image

import double_precision
from pictures import degraded, pictures

HERE = Path(__file__).parent


def ssimulacra2(program, truth, image):
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / name) for name in ("truth.png", "image.png")]
        for path, picture in zip(paths, (truth, image)):
            Image.fromarray(picture).save(path)
        return float(subprocess.run([program, *paths], check=True, capture_output=True, text=True).stdout)


def turned(picture):
    """The part of a picture whose sides are multiples of 32, in all eight ways to turn and mirror it."""
    height, width = (side // 32 * 32 for side in picture.shape[:2])
    quarters = [np.rot90(picture[:height, :width], quarter) for quarter in range(4)]
    return [np.ascontiguousarray(way) for quarter in quarters for way in (quarter, quarter[:, ::-1])]


def main(program):
    golden = {}
    for name, truth in pictures().items():
        image = degraded(truth)
        floats = [picture.astype(np.float32) / 255 for picture in (truth, image)]
        error, mean, _ = flip_evaluator.evaluate(*floats, "LDR", inputsRGB=True, applyMagma=False)
        golden[name] = {
            "flip": float(mean),
            # One row of the map through the middle, every tenth pixel.
            "flip_row": [float(value) for value in error[error.shape[0] // 2, ::10].reshape(-1)],
            "ssimulacra2": ssimulacra2(program, truth, image),
            "ssimulacra2_double": double_precision.ssimulacra2(truth, image),
            "ssimulacra2_turned": [ssimulacra2(program, *pair) for pair in zip(turned(truth), turned(image))],
        }
    (HERE / "perceptual.json").write_text(json.dumps(golden, indent=2) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
