"""Writes params/niqe_pristine.f64le from BasicSR's niqe_pris_params.npz: mean, covariance, window; little-endian f64.

    python niqe_params.py .../basicsr/metrics/niqe_pris_params.npz ../../params/niqe_pristine.f64le
"""

import sys

import numpy as np

source, target = sys.argv[1:]
params = np.load(source)
arrays = [params[name] for name in ("mu_pris_param", "cov_pris_param", "gaussian_window")]
assert [array.size for array in arrays] == [36, 36 * 36, 49]
with open(target, "wb") as file:
    for array in arrays:
        file.write(array.astype("<f8").tobytes())
