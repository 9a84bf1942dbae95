"""Systematic floor of a fitted rim: what no number of edge points averages out.

Fitted so that the covariances of single rims are as the errors of rendered rims, Moon and Bennu together.
Each alone wants one of the two parts: elliptic rims 0.049 +- 0.004 px and next to none in radii, irregular
ones 0.0054 +- 0.0020 radii and none in pixels.
"""

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, Scale, estimate, gaussian_cost
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.calibration.rendered_descents import MeasuredDescent, measured_descents
from craternav_fg.vision.ellipse_fit import FitOptions
from factors.arrays import FloatArray


def rim_floor() -> list[Regenerated]:
    """Regenerate `FitOptions.floor_px` and `floor_share`.

    Returns
    -------
    list of Regenerated
    """
    shipped = FitOptions()
    parts = [_parts(descent) for descent in measured_descents()]

    def costs(values: FloatArray) -> FloatArray:
        px, share = values
        totals = []
        for error, rest, floor, minor_px in parts:
            sigma2 = (px + share * minor_px) ** 2
            totals.append(gaussian_cost(error, rest + sigma2[:, None, None] * floor).sum())
        return np.array(totals)

    start = [
        Parameter(shipped.floor_px, Scale.LINEAR, 0.01),
        Parameter(shipped.floor_share, Scale.LINEAR, 0.001),
    ]
    (px, share), (px_error, share_error) = estimate(costs, start)
    return [
        Regenerated("FitOptions.floor_px, px", shipped.floor_px, px, px_error),
        Regenerated("FitOptions.floor_share, radii", shipped.floor_share, share, share_error),
    ]


def _parts(descent: MeasuredDescent) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors of a descent's rims, covariances without the floor and of a floor of 1 px, semi-minor axes."""
    shipped = FitOptions()
    error = np.concatenate([rims.error for rims in descent.rims])
    floor = np.concatenate([rims.unit_floor for rims in descent.rims])
    minor_px = np.concatenate([rims.minor_px for rims in descent.rims])
    whole = np.concatenate([rims.points + rims.systematic for rims in descent.rims])
    sigma2 = (shipped.floor_px + shipped.floor_share * minor_px) ** 2
    return error, whole - sigma2[:, None, None] * floor, floor, minor_px
