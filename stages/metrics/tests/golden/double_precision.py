"""SSIMULACRA2 2.1 in double precision, by its published formulas (Sneyers 2022); the blur as in Charalampidis 2016, of whose recursive
filter the impulse response is taken. Its weights are read from our own table: that they are the reference's shows in libjxl's scores.
"""

import re
from pathlib import Path

import numpy as np

TABLE = Path(__file__).parents[2] / "src/ssimulacra2/weights.rs"
WEIGHTS = np.array([float(x.replace("_", "")) for x in re.findall(r"\d+\.[\d_]+", TABLE.read_text().split("=", 1)[1])])
ABSORBANCE = np.array([[0.3, 0.622, 0.078], [0.23, 0.692, 0.078], [0.24342269, 0.20476745, 0.55180986]])
BIAS = 0.0037930734


def taps(sigma=1.5):
    """The filter's response to a lone point; equations as numbered in the paper."""
    radius = round(3.2795 * sigma + 0.2546)  # (57)
    omega = np.array([1, 3, 5]) * np.pi / (2 * radius)
    p = np.array([1, -1, 1]) / np.tan(omega / 2)  # (37)
    r = np.array([1, -1, 1]) * p * p / np.sin(omega)  # (44)
    rho = np.exp(-0.5 * sigma**2 * omega**2) / radius  # (50)
    d13, d35, d51 = (p[i] * r[j] - r[i] * p[j] for i, j in [(0, 1), (1, 2), (2, 0)])
    zeta = np.array([d35 / d13, d51 / d13, 1])  # (52)
    gamma = np.array([1, radius**2 - sigma**2, zeta @ rho])  # (55)
    beta = np.linalg.solve(np.array([p, r, zeta]), gamma)  # (53)
    # (33) and (35): out[n] = g (in[n - R - 1] + in[n + R - 1]) - d out[n - 1] - out[n - 2], for each cosine.
    length = 4 * radius
    point = np.zeros(length)
    point[2 * radius] = 1
    response = np.zeros(length)
    for k in range(3):
        gain, d = -beta[k] * np.cos(omega[k] * (radius + 1)), -2 * np.cos(omega[k])
        out = np.zeros(length + 2)
        for n in range(length):
            ends = (point[n - radius - 1] if n > radius else 0) + (point[n + radius - 1] if n + radius - 1 < length else 0)
            out[n + 2] = gain * ends - d * out[n + 1] - out[n]
        response += out[2:]
    return response[radius : 3 * radius + 1]


TAPS = taps()


def blurred(plane):
    """Beyond the border there is 0."""
    reach = len(TAPS) // 2

    def along(line):
        return np.convolve(line, TAPS)[reach:-reach]

    return np.apply_along_axis(along, 0, np.apply_along_axis(along, 1, plane))


def xyb(linear):
    cones = np.cbrt(linear @ ABSORBANCE.T + BIAS) - np.cbrt(BIAS)
    x, y = (cones[..., 0] - cones[..., 1]) / 2, (cones[..., 0] + cones[..., 1]) / 2
    return [14 * x + 0.42, y + 0.01, cones[..., 2] - y + 0.55]


def halved(linear):
    height, width, _ = linear.shape
    padded = np.pad(linear, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return sum(padded[y::2, x::2] for y in (0, 1) for x in (0, 1)) / 4


def errors(a, b):
    mean_a, mean_b, aa, bb, ab = (blurred(plane) for plane in (a, b, a * a, b * b, a * b))
    covariance = 2 * (ab - mean_a * mean_b) + 0.0009
    structure = 1 - (1 - (mean_a - mean_b) ** 2) * covariance / (aa - mean_a**2 + bb - mean_b**2 + 0.0009)
    edge = (1 + abs(b - mean_b)) / (1 + abs(a - mean_a)) - 1
    maps = [np.maximum(error, 0) for error in (structure, edge, -edge)]
    return [[error.mean() for error in maps], [(error**4).mean() ** 0.25 for error in maps]]


def ssimulacra2(truth, image):
    # As programs hand pictures on: single precision until here.
    encoded = [(picture.astype(np.float32) / 255).astype(float) for picture in (truth, image)]
    a, b = (np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4) for x in encoded)
    scales = []
    for scale in range(6):
        if scale:
            a, b = halved(a), halved(b)
        scales.append([errors(*planes) for planes in zip(xyb(a), xyb(b))])
    by_channel = np.array(scales).transpose(1, 0, 2, 3)  # channel, scale, norm, error
    x = 0.9562382616834844 * (WEIGHTS @ by_channel.reshape(-1))
    curve = 2.326765642916932 * x - 0.020884521182843837 * x**2 + 6.248496625763138e-5 * x**3
    return 100 - 10 * curve**0.6276336467831387 if curve > 0 else 100.0
