"""Memory of a crater's pooled covariance, and how many frames its prior counts for.

What a fit claims, beside the other rims of its frame, is modelled as a part that belongs to the crater and
fades as its image changes, and a part that is new in each frame. The prior of the best mean over frames
counts for as many frames as the variance of the new part over that of the crater's.

Claims of single frames hardly scatter beside those of craters, so the fit gives a prior of less than a tenth
of a frame. It is kept at two frames: on three rendered descents to Bennu (trials 5, 6 and 31) the smoother's
ANEES is then 16.5, 11.6 and 8.4, with a tenth of a frame 21.6, 11.5 and 8.4. Position errors are alike.
"""

from collections import defaultdict

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, estimate, gaussian_cost
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.calibration.rendered_descents import MeasuredDescent, measured_descents
from craternav_fg.ellipse import shape_change
from craternav_fg.vision.error_model.pooling import MEMORY, MIN_OUTLINE_SHARE, PRIOR_FRAMES
from factors.arrays import FloatArray

# The mean claim of fewer rims is too uncertain to compare with.
_MIN_RIMS = 4


def pooling() -> list[Regenerated]:
    """Regenerate `MEMORY` and `PRIOR_FRAMES`.

    Returns
    -------
    list of Regenerated
    """
    rough = [_claims(descent) for descent in measured_descents()]
    rough = [claims for claims in rough if claims]

    def costs(values: FloatArray) -> FloatArray:
        of_crater, prior_frames, memory = values
        totals = np.zeros(len(rough))
        for k, claims in enumerate(rough):
            for log_variance, change in claims:
                covariance = np.exp(-change / memory) + prior_frames * np.eye(len(change))
                totals[k] += float(gaussian_cost(log_variance, of_crater * covariance))
        return totals

    values, errors = estimate(costs, [Parameter(0.2), Parameter(0.2), Parameter(MEMORY)])
    return [
        Regenerated("pooling.MEMORY", MEMORY, float(values[2]), float(errors[2])),
        Regenerated(
            "pooling.PRIOR_FRAMES, frames", PRIOR_FRAMES, float(values[1]), float(errors[1]), Relation.KEPT,
            0.0,
        ),
    ]  # fmt: skip


def _claims(descent: MeasuredDescent) -> list[tuple[FloatArray, FloatArray]]:
    """Logarithms (m,) of a crater's mean systematic variance on the ground, beside its frame's, and changes.

    Only frames with irregular outlines count.
    """
    seen: dict[int, list[tuple[float, FloatArray]]] = defaultdict(list)
    for rims in descent.rims:
        if np.median(rims.outline_share) <= MIN_OUTLINE_SHARE or len(rims.error) < _MIN_RIMS:
            continue
        _, log_slopes = np.linalg.slogdet(rims.slopes)
        _, log_systematic = np.linalg.slogdet(rims.systematic)
        log_variance = (log_systematic - 2.0 * log_slopes) / 5.0
        for i, crater in enumerate(rims.craters.tolist()):
            seen[crater].append((float(log_variance[i] - log_variance.mean()), rims.chart[i]))
    out = []
    for track in seen.values():
        charts = np.array([chart for _, chart in track])
        along = np.concatenate([[0.0], np.cumsum(shape_change(charts[:-1], charts[1:]))])
        out.append((np.array([value for value, _ in track]), np.abs(along[:, None] - along)))
    return out
