"""How far from a rim crest the blurred brightness of its slopes crosses that of flat terrain; compiled.

A crest whose inner and outer side are alike shows the crossing where it is; the steeper wall displaces it
outward, the more so the more the image is blurred. What the displacement is without any blur is not seen.
Under a second, wider smoothing the crossing moves farther: by how much, relative to the canonical crater, is
the crest's bluntness. A crest that is sharp within the blur moves in proportion to the blur, one that is
wide with its square, so from the bluntness alone the displacement of a sharp crest is underestimated and that
of a round one overestimated. How narrow a crest is shows in how fast the brightness falls at the crossing.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Prior weight of the canonical crater's displacement against the observed one, px^2.
_BLUNTNESS_PRIOR_PX2 = 0.1
# Range of the bluntness and of the narrowness.
_LEAST_BLUNTNESS, _LARGEST_BLUNTNESS = -0.5, 2.0
_LEAST_NARROWNESS, _LARGEST_NARROWNESS = 0.6, 3.0
# Displacement over the canonical crater's: coefficients of b, b^2 and b ln n, with the bluntness b and the
# narrowness n. Fitted over three families of crests by `craternav_fg.calibration.crest_asymmetry`.
DISPLACEMENT = (0.771, 0.307, 0.305)
# What the lift does to the brightness at the crest's share of the step between the flanks, beyond what it
# does to the canonical crater's, over the slope contrast, the lift, the square of the steepness and the
# logarithm of the narrowness. Fitted as well.
FLANK_LIFT = 0.031


@njit(cache=True, error_model="numpy")
def bluntness(
    moved_px: FloatArray, expected_px: FloatArray, others_px: FloatArray, contrasts: FloatArray
) -> float:  # fmt: skip
    """Compare how far crossings move under more smoothing with the canonical crater's.

    Parameters
    ----------
    moved_px : ndarray, shape (n,)
        Outward motion of the crossings.
    expected_px, others_px : ndarray, shape (n,)
        Motion that the asymmetry of the canonical crater makes, and that which the second order of the slope
        and the lift make, see `crest_tables.crossing_parts`.
    contrasts : ndarray, shape (n,)
        Slope contrast across the rim.

    Returns
    -------
    float
        1 for the canonical crater, 0 for a crest whose sides are alike.
    """
    dot, square = _BLUNTNESS_PRIOR_PX2, _BLUNTNESS_PRIOR_PX2
    for i in range(len(moved_px)):
        moved = moved_px[i] - others_px[i]
        # False where the crossing is lost under more smoothing.
        if np.abs(moved) < 4.0 * np.abs(expected_px[i]) + 0.5:
            weight = contrasts[i] * contrasts[i]
            dot += weight * moved * expected_px[i]
            square += weight * expected_px[i] * expected_px[i]
    return dot / square


@njit(cache=True, error_model="numpy")
def displacement_terms(blunt: float, narrowness: float) -> tuple[float, float, float]:
    """Compute what `DISPLACEMENT` is multiplied with.

    Parameters
    ----------
    blunt : float
        See `bluntness`.
    narrowness : float
        Fall of the brightness at the crossing over the step between the flanks, over the canonical crater's.

    Returns
    -------
    b, b2, b_log_n : float
        Dimensionless.
    """
    b = min(max(blunt, _LEAST_BLUNTNESS), _LARGEST_BLUNTNESS)
    n = min(max(narrowness, _LEAST_NARROWNESS), _LARGEST_NARROWNESS)
    return b, b * b, b * np.log(n)


@njit(cache=True, error_model="numpy")
def displacement_share(blunt: float, narrowness: float) -> float:
    """Compute the displacement of a crossing by the asymmetry of its crest.

    Parameters
    ----------
    blunt, narrowness : float
        See `displacement_terms`.

    Returns
    -------
    float
        Over that of the canonical crater.
    """
    b, b2, b_log_n = displacement_terms(blunt, narrowness)
    return DISPLACEMENT[0] * b + DISPLACEMENT[1] * b2 + DISPLACEMENT[2] * b_log_n


@njit(cache=True, error_model="numpy")
def lift_of_flanks(steepness: float, narrowness: float) -> float:
    """Compute how much brighter the lift makes both flanks than the canonical crater's.

    In an oblique view the flanks have more or less of a round crest on them; those of a sharp one are walls
    that are stretched or foreshortened.

    Parameters
    ----------
    steepness : float
        Over the canonical crater's.
    narrowness : float
        See `displacement_terms`.

    Returns
    -------
    float
        Relative brightness at the crest's share of the step, over the slope contrast and the lift.
    """
    n = min(max(narrowness, _LEAST_NARROWNESS), _LARGEST_NARROWNESS)
    return FLANK_LIFT * steepness * steepness * np.log(n)
