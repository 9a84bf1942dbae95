"""Systematic floor of a fitted rim: what no number of edge points averages out.

The level of the ground at a rim is as uncertain as it varies, in the image and around the rim; the edges move
with it. Fitted so that the covariances of single rims are as the errors of rendered rims, of Moon, Dione and
Bennu together; what all rims have in common is in the covariances, or it would count twice.

The ground of these renders has one albedo. That of the tests' second simulator has patches, and its rims err
with heavier tails: a fit wants 0.33 and 0.32 there (`python -m tests.foreign.rim_floor`). What a frame's rims
show of that is in its variance factor (`error_model.frame_scatter`).
"""

from collections.abc import Sequence

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, estimate, gaussian_cost
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.calibration.rendered_descents import measured_descents
from craternav_fg.calibration.single_rims import SingleRims
from craternav_fg.linalg import squared_distance
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import FloatArray

# Squared distance, 5 degrees of freedom, of a rim that is another crater's.
_OUTLIER2 = 60.0


def rim_floor() -> list[Regenerated]:
    """Regenerate `GuidedOptions.level_scatter_share` and `level_rim_share`.

    Returns
    -------
    list of Regenerated
    """
    return level_shares([descent.single for descent in measured_descents()])


def level_shares(descents: Sequence[Sequence[SingleRims]]) -> list[Regenerated]:
    """Fit the shares of the ground's level that stay unknown to the errors of single rims.

    Parameters
    ----------
    descents : sequence of sequence of SingleRims
        The images of each.

    Returns
    -------
    list of Regenerated
    """
    shipped = GuidedOptions()
    start = np.array([shipped.level_scatter_share, shipped.level_rim_share])
    parts = []
    for images in descents:
        error, rest, of_scatter, of_rim = (
            np.concatenate([getattr(one, name) for one in images]) for name in SingleRims.__dataclass_fields__
        )
        whole = rest + start[0] ** 2 * of_scatter + start[1] ** 2 * of_rim
        right = squared_distance(error, whole) < _OUTLIER2
        parts.append((error[right], rest[right], of_scatter[right], of_rim[right]))

    def costs(values: FloatArray) -> FloatArray:
        scatter2, rim2 = values**2
        return np.array(
            [
                gaussian_cost(error, rest + scatter2 * of_scatter + rim2 * of_rim).sum()
                for error, rest, of_scatter, of_rim in parts
            ]
        )

    values, errors = estimate(costs, [Parameter(float(share)) for share in start])
    return [
        Regenerated("GuidedOptions.level_scatter_share", start[0], float(values[0]), float(errors[0])),
        Regenerated("GuidedOptions.level_rim_share", start[1], float(values[1]), float(errors[1])),
    ]
