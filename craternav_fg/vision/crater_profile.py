"""Canonical crater: its cross-section, and what an image shows of it.

Cross-section over the radius rho (rim crest at 1), heights in radii: a parabolic bowl, an apron that falls
with rho^-3, and their soft minimum, which rounds the rim crest:

    bowl = -depth + (depth + rim) rho^2,  apron = rim rho^-3,
    height = -round ln(exp(-bowl / round) + exp(-apron / round)).

Brightness relative to flat terrain: (1 + contrast slope) / sqrt(1 + slope^2), not below 0, as for a
Lambertian surface in the plane of the cross-section, where the slope rises outward and the contrast is that
across the rim.

In an image that is taken obliquely, ground appears displaced by its height: outward by the lift times the
height over the rim crest. Ground that other ground hides is not seen.
"""

from functools import cache

import numpy as np

from factors.arrays import FloatArray

# A fresh simple crater: depth 0.2 and rim height 0.04 of the diameter (Pike 1977). The rounding, a height,
# makes the rim crest about 4 % of the radius wide.
BOWL_DEPTH_RADII = 0.32
RIM_HEIGHT_RADII = 0.08
CREST_ROUNDING_RADII = 0.04

# Samples of the cross-section, from beyond the centre, and of its image, in radii.
STEP_RADII = 0.002
_SECTION_RADII = np.arange(-1.0, 2.0, STEP_RADII)
IMAGE_RADII = np.arange(0.1, 1.9, STEP_RADII)
# Nearer to the centre the bowl counts as level.
_LEAST_RADIUS = 1e-3


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
def seen_ground(lift: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute which ground of the canonical cross-section is seen along its image.

    Parameters
    ----------
    lift : float
        Outward displacement, in radii, of ground that is a radius higher than the rim crest. Below 0 the
        camera looks over the rim crest from outside.

    Returns
    -------
    distance, height, slope : ndarray, shape (n,)
        At `IMAGE_RADII`, where 1 is the image of the rim crest: distance from the centre and height over the
        rim crest, in radii, and rise over run outward.
    """
    rho = _SECTION_RADII
    slope = np.sign(rho) * slopes(np.maximum(np.abs(rho), _LEAST_RADIUS))
    height = np.cumsum(slope) * STEP_RADII
    height -= np.interp(1.0, rho, height)
    image = rho + lift * height
    if lift < 0.0:
        seen = image <= np.minimum.accumulate(image[::-1])[::-1]
    else:
        seen = image >= np.maximum.accumulate(image)
    distance, height, slope = (
        np.interp(IMAGE_RADII, image[seen], of_ground[seen]) for of_ground in (rho, height, slope)
    )
    return distance, height, slope


def excess_brightness(slope: FloatArray, contrast: float) -> FloatArray:
    """Compute the brightness of sloping ground relative to that of flat terrain, less 1.

    Parameters
    ----------
    slope : ndarray, shape (n,)
        Rise over run outward.
    contrast : float
        Slope contrast across the rim.

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.asarray(np.maximum(1.0 + contrast * slope, 0.0) / np.sqrt(1.0 + slope**2) - 1.0)


def blurred(profile: FloatArray, blurs: FloatArray) -> FloatArray:
    """Blur a profile of the image by Gaussians.

    Parameters
    ----------
    profile : ndarray, shape (n,)
        Dimensionless, at `IMAGE_RADII`.
    blurs : ndarray, shape (m,)
        Standard deviations, in radii.

    Returns
    -------
    ndarray, shape (m, n)
    """
    reach = len(profile) // 2
    padded = np.pad(profile, reach, mode="edge")
    frequency = 2.0 * np.pi * np.fft.rfftfreq(len(padded), STEP_RADII)
    transfer = np.exp(-0.5 * (blurs[:, None] * frequency) ** 2)
    out = np.fft.irfft(transfer * np.fft.rfft(padded), len(padded), axis=-1)
    return np.asarray(out[:, reach : reach + len(profile)])


def crossing(profile: FloatArray, near: float) -> float:
    """Find where a profile of the image falls through zero.

    Parameters
    ----------
    profile : ndarray, shape (n,)
        Dimensionless, at `IMAGE_RADII`.
    near : float
        Distance from the centre, in radii.

    Returns
    -------
    float
        The place nearest to it, in radii; itself if there is none.
    """
    falls = np.flatnonzero((profile[:-1] > 0.0) & (profile[1:] <= 0.0))
    if len(falls) == 0:
        return near
    i = falls[np.argmin(np.abs(IMAGE_RADII[falls] - near))]
    return float(IMAGE_RADII[i] + profile[i] / (profile[i] - profile[i + 1]) * STEP_RADII)


def _raw_slope(rho: FloatArray) -> FloatArray:
    """Slopes (n,) at radii (n,) in units in which bowl and apron would meet at 1 without rounding."""
    rim = BOWL_DEPTH_RADII + RIM_HEIGHT_RADII
    bowl = -BOWL_DEPTH_RADII + rim * rho**2
    apron = RIM_HEIGHT_RADII * rho**-3.0
    share = 1.0 / (1.0 + np.exp(np.clip((bowl - apron) / CREST_ROUNDING_RADII, -60.0, 60.0)))
    return np.asarray(share * 2.0 * rim * rho - (1.0 - share) * 3.0 * RIM_HEIGHT_RADII * rho**-4.0)


@cache
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
