"""Time-correlated error of the edge points of an arc of a rim: an outward shift that they share."""

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, estimate
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.calibration.rendered_descents import measured_descents
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, arc_sigma_px
from factors.arrays import FloatArray


def arcs() -> list[Regenerated]:
    """Regenerate `CorrelatedErrorOptions.arc_px` and `arc_share`.

    Returns
    -------
    list of Regenerated
    """
    shipped = CorrelatedErrorOptions()
    descents = [descent.arcs for descent in measured_descents()]

    def costs(values: FloatArray) -> FloatArray:
        options = CorrelatedErrorOptions(arc_px=float(values[0]), arc_share=float(values[1]))
        totals = np.zeros(len(descents))
        for k, frames in enumerate(descents):
            for frame in frames:
                sigma = np.array([arc_sigma_px(b, frame.outline_share, options) for b in frame.minor_px])
                variance = sigma**2 + frame.white_px2
                totals[k] += 0.5 * float(np.sum(np.log(variance) + frame.shift_px**2 / variance))
        return totals

    values, errors = estimate(costs, [Parameter(shipped.arc_px), Parameter(shipped.arc_share)])
    return [
        Regenerated(
            "CorrelatedErrorOptions.arc_px, px", shipped.arc_px, float(values[0]), float(errors[0])
        ),
        Regenerated(
            "CorrelatedErrorOptions.arc_share, radii", shipped.arc_share, float(values[1]), float(errors[1])
        ),
    ]  # fmt: skip
