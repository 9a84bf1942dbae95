"""Where a blurred rim's brightness crosses that of level ground: a canonical crater.

Cross-section over the radius rho (crest at 1), heights in radii: a parabolic bowl, an apron falling
with rho^-3, and their soft minimum, which rounds the crest:

    bowl = -depth + (depth + rim) rho^2,  apron = rim rho^-3,
    height = -round ln(exp(-bowl / round) + exp(-apron / round)).

Brightness relative to level ground: (1 + gain slope) / sqrt(1 + slope^2), not below 0, as for a
Lambertian surface in the plane of the cross-section.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# A fresh simple crater: depth 0.2 and rim height 0.04 of the diameter (Pike 1977).
BOWL_DEPTH_RADII = 0.32
RIM_HEIGHT_RADII = 0.08
CREST_ROUNDING_RADII = 0.04

BLUR_RADII = np.linspace(0.0, 0.24, 13)
SLOPE_CONTRASTS = np.linspace(-4.0, 4.0, 17)


def slopes(rho: FloatArray) -> FloatArray:
    """Slope of the canonical cross-section, rising outward, at radii (n,) from the crest's."""
    crest = _crest_radius()
    return _raw_slope(rho * crest)


@cache
def crossing_table() -> FloatArray:
    """Outward displacement of the crossing in radii, shape (len(BLUR_RADII), len(SLOPE_CONTRASTS))."""
    step = 0.002
    rho = np.arange(0.3, 1.9, step)
    slope = slopes(rho)
    table = np.zeros((len(BLUR_RADII), len(SLOPE_CONTRASTS)))
    for j, gain in enumerate(SLOPE_CONTRASTS):
        # The sign of a vanishing gain does not matter, its limit does.
        g = gain if gain != 0.0 else 1e-3
        excess = np.maximum(1.0 + g * slope, 0.0) / np.sqrt(1.0 + slope**2) - 1.0
        for i, blur in enumerate(BLUR_RADII):
            table[i, j] = _crossing(rho, np.sign(g) * _blurred(excess, blur / step)) - 1.0
    # At zero gain the slope's square is all there is: take the mean of the neighbours.
    middle = len(SLOPE_CONTRASTS) // 2
    table[:, middle] = 0.5 * (table[:, middle - 1] + table[:, middle + 1])
    table.flags.writeable = False
    return table


def _raw_slope(rho: FloatArray) -> FloatArray:
    bowl = -BOWL_DEPTH_RADII + (BOWL_DEPTH_RADII + RIM_HEIGHT_RADII) * rho**2
    apron = RIM_HEIGHT_RADII * rho**-3.0
    share = 1.0 / (1.0 + np.exp(np.clip((bowl - apron) / CREST_ROUNDING_RADII, -60.0, 60.0)))
    return np.asarray(
        share * 2.0 * (BOWL_DEPTH_RADII + RIM_HEIGHT_RADII) * rho
        - (1.0 - share) * 3.0 * RIM_HEIGHT_RADII * rho**-4.0
    )


def _crest_radius() -> float:
    low, high = 0.8, 1.2
    for _ in range(50):
        mid = 0.5 * (low + high)
        if _raw_slope(np.array([mid]))[0] > 0.0:
            low = mid
        else:
            high = mid
    return 0.5 * (low + high)


def _blurred(values: FloatArray, sigma: float) -> FloatArray:
    if sigma < 0.5:
        return values
    reach = int(np.ceil(4.0 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"))


def _crossing(rho: FloatArray, values: FloatArray) -> float:
    down = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if len(down) == 0:
        return 1.0
    i = down[np.argmin(np.abs(rho[down] - 1.0))]
    return float(rho[i] + values[i] / (values[i] - values[i + 1]) * (rho[i + 1] - rho[i]))
