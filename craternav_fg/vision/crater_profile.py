"""Canonical crater: its cross-section, and where its blurred rim is as bright as flat terrain.

Cross-section over the radius rho (rim crest at 1), heights in radii: a parabolic bowl, an apron that falls
with rho^-3, and their soft minimum, which rounds the rim crest:

    bowl = -depth + (depth + rim) rho^2,  apron = rim rho^-3,
    height = -round ln(exp(-bowl / round) + exp(-apron / round)).

Brightness relative to flat terrain: (1 + contrast slope) / sqrt(1 + slope^2), not below 0, as for a
Lambertian surface in the plane of the cross-section, where the slope rises outward and the contrast is that
across the rim.
"""

from functools import cache

import numpy as np

from factors.arrays import FloatArray

# A fresh simple crater: depth 0.2 and rim height 0.04 of the diameter (Pike 1977). The rounding, a height,
# makes the rim crest about 4 % of the radius wide.
BOWL_DEPTH_RADII = 0.32
RIM_HEIGHT_RADII = 0.08
CREST_ROUNDING_RADII = 0.04

# Grid of the table of crossings: standard deviation of the blur, in radii, and slope contrast across the rim.
BLUR_RADII = np.linspace(0.0, 0.24, 13)
SLOPE_CONTRASTS = np.linspace(-4.0, 4.0, 17)
# Samples of the cross-section that is blurred, in radii, and the contrast that stands for the limit at zero.
_STEP_RADII, _FIRST_RADIUS, _LAST_RADIUS = 0.002, 0.3, 1.9
_VANISHING_CONTRAST = 1e-3


def slopes(rho: FloatArray) -> FloatArray:
    """Compute the slope of the canonical cross-section.

    Parameters
    ----------
    rho : ndarray, shape (n,)
        Distance from the centre, in radii of the rim crest; positive.

    Returns
    -------
    ndarray, shape (n,)
        Rise over run, positive where the ground rises outward.
    """
    crest = _crest_radius()
    return _raw_slope(rho * crest)


@cache
def crossing_table() -> FloatArray:
    """Compute where the blurred rim is as bright as flat terrain.

    Returns
    -------
    ndarray, shape (13, 17)
        Outward displacement from the rim crest, in radii, on the grid of `BLUR_RADII` and `SLOPE_CONTRASTS`.
    """
    rho = np.arange(_FIRST_RADIUS, _LAST_RADIUS, _STEP_RADII)
    slope = slopes(rho)
    table = np.zeros((len(BLUR_RADII), len(SLOPE_CONTRASTS)))
    for j, grid_contrast in enumerate(SLOPE_CONTRASTS):
        # The sign of a vanishing contrast does not matter, its limit does.
        contrast = grid_contrast if grid_contrast != 0.0 else _VANISHING_CONTRAST
        excess = np.maximum(1.0 + contrast * slope, 0.0) / np.sqrt(1.0 + slope**2) - 1.0
        for i, blur in enumerate(BLUR_RADII):
            profile = np.sign(contrast) * _blurred(excess, blur / _STEP_RADII)
            table[i, j] = _crossing(rho, profile) - 1.0
    # At zero contrast the square of the slope is all there is: take the mean of the neighbours.
    middle = len(SLOPE_CONTRASTS) // 2
    table[:, middle] = 0.5 * (table[:, middle - 1] + table[:, middle + 1])
    table.flags.writeable = False
    return table


def _raw_slope(rho: FloatArray) -> FloatArray:
    """Slopes (n,) at radii (n,) in units in which bowl and apron would meet at 1 without rounding."""
    rim = BOWL_DEPTH_RADII + RIM_HEIGHT_RADII
    bowl = -BOWL_DEPTH_RADII + rim * rho**2
    apron = RIM_HEIGHT_RADII * rho**-3.0
    share = 1.0 / (1.0 + np.exp(np.clip((bowl - apron) / CREST_ROUNDING_RADII, -60.0, 60.0)))
    return np.asarray(share * 2.0 * rim * rho - (1.0 - share) * 3.0 * RIM_HEIGHT_RADII * rho**-4.0)


def _crest_radius() -> float:
    """Find the radius at which the slope of the rounded cross-section is zero, by bisection."""
    low, high = 0.8, 1.2
    for _ in range(50):
        mid = 0.5 * (low + high)
        if _raw_slope(np.array([mid]))[0] > 0.0:
            low = mid
        else:
            high = mid
    return 0.5 * (low + high)


def _blurred(values: FloatArray, sigma: float) -> FloatArray:
    """Profile (n,) after Gaussian blur; `sigma` is in samples."""
    if sigma < 0.5:
        return values
    reach = int(np.ceil(4.0 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"))


def _crossing(rho: FloatArray, values: FloatArray) -> float:
    """Radius of the fall through zero that is nearest the rim crest; 1 if there is none."""
    down = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if len(down) == 0:
        return 1.0
    i = down[np.argmin(np.abs(rho[down] - 1.0))]
    return float(rho[i] + values[i] / (values[i] - values[i + 1]) * (rho[i + 1] - rho[i]))
