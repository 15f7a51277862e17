"""Writes metrics.json: what scikit-image and BasicSR say of the pictures beside this script.

    python metrics.py .../basicsr-1.4.2/basicsr        (an unpacked source distribution; it need not be installed)

needs numpy, scipy, scikit-image, Pillow and torch. skyline.png and portrait.png are cut from two CC0 photos of the
gb82 image set; the degraded versions and the texture are made here and, in the same way, by the test.
"""

import importlib
import json
import sys
import types
from pathlib import Path

import numpy as np
import scipy.ndimage
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from pictures import degraded, pictures

HERE = Path(__file__).parent


def load_niqe(basicsr):
    """Imports BasicSR's niqe.py alone: stubs stand for OpenCV (unused for the Y channel) and for its registry."""
    for name, path in {"basicsr": basicsr, "basicsr.utils": basicsr / "utils", "basicsr.metrics": basicsr / "metrics"}.items():
        sys.modules[name] = types.ModuleType(name)
        sys.modules[name].__path__ = [str(path)]
    registry = types.ModuleType("basicsr.utils.registry")
    registry.METRIC_REGISTRY = types.SimpleNamespace(register=lambda: lambda function: function)
    sys.modules["basicsr.utils.registry"] = registry
    sys.modules.setdefault("cv2", types.ModuleType("cv2"))
    sys.modules["scipy.ndimage.filters"] = scipy.ndimage  # its name before SciPy 2
    sys.modules["basicsr.utils"].bgr2ycbcr = importlib.import_module("basicsr.utils.color_util").bgr2ycbcr
    return importlib.import_module("basicsr.metrics.niqe").calculate_niqe


def halve_in_double(plane, scale, antialiasing):
    """BasicSR's imresize to half size, its eight weights summed in double instead of single precision."""
    weights = np.array([-0.01171875, -0.03515625, 0.11328125, 0.43359375])
    weights = np.concatenate([weights, weights[::-1]])

    def halve_rows(rows):
        padded = np.concatenate([rows[2::-1], rows, rows[:-4:-1]]).astype(np.float64)
        return sum(weights[k] * padded[k : k + len(rows) : 2] for k in range(8)).astype(np.float32)

    return halve_rows(halve_rows(plane).T).T


def main(basicsr):
    niqe = load_niqe(Path(basicsr))
    golden = {}
    for name, truth in pictures().items():
        image = degraded(truth)
        a, b = truth / 255.0, image / 255.0
        options = dict(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=2)
        golden[name] = {
            "psnr": peak_signal_noise_ratio(a, b, data_range=1.0),
            "ssim": structural_similarity(a, b, **options),
            "niqe": niqe(truth[..., ::-1], 0),
            "niqe_degraded": niqe(image[..., ::-1], 0),
        }
    # In flat areas the rounding noise of BasicSR's single-precision halving moves NIQE in the third decimal.
    sys.modules["basicsr.metrics.niqe"].imresize = halve_in_double
    for name, truth in pictures().items():
        golden[name]["niqe_double"] = niqe(truth[..., ::-1], 0)
        golden[name]["niqe_degraded_double"] = niqe(degraded(truth)[..., ::-1], 0)
    (HERE / "metrics.json").write_text(json.dumps(golden, indent=2) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
