"""Whether the sizes of rims agree with the distances between them: the scale of the catalogue's places."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.intrinsics_check import to_be_averaged
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Fewer rims do not show how far their sizes scatter.
_MIN_RIMS = 30
# Squared distance of a size beyond which a rim is another crater's.
_OUTLIER2 = 25.0
# Logarithm of a rim's size in its chart.
_SIZE = np.array([0.0, 0.0, 0.5, 0.0, 0.5])


class Growth(NamedTuple):
    """How much larger rims are than their craters from where a trajectory sees them: a share."""

    share: float
    sigma_share: float


def growth_of_rims(
    frames: Sequence[FrameMeasurement],
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    *,
    stated_errors: bool = True,
) -> Growth | None:
    """Compare the sizes of rims with those of their craters from the poses of a smoother.

    Where several craters are in view the distances between them tell the camera's altitude far better than
    their sizes do.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m.
    camera : Camera
    catalog : Catalog
    stated_errors : bool
        Whether the catalogue itself states its errors, if it has some; those that the rims told contain this
        very growth.

    Returns
    -------
    Growth or None
        None with few rims.
    """
    alike = to_be_averaged([frame.rims for frame in frames], catalog)
    growths, variances = list[FloatArray](), list[FloatArray]()
    for rims, pose in zip(alike, np.ascontiguousarray(gTb), strict=True):
        rows = rims.craters
        charts, visible = project_rims(pose, camera.bTc, catalog.centres[rows], catalog.axes[rows])
        growth, variance = (rims.chart - charts) @ _SIZE, _SIZE @ rims.covariance @ _SIZE
        kept = visible & (growth**2 < _OUTLIER2 * variance)
        growths.append(growth[kept])
        variances.append(variance[kept])
    growth, weights = np.concatenate([*growths, np.empty(0)]), 1.0 / np.concatenate([*variances, np.empty(0)])
    if len(growth) < _MIN_RIMS:
        return None
    mean = float(weights @ growth / weights.sum())
    variance = max(float(np.mean(weights * (growth - mean) ** 2)), 1.0) / float(weights.sum())
    if catalog.errors is not None and stated_errors:
        # What a catalogue calls a rim may differ for all of its craters alike, by about as much.
        shown = np.unique(np.concatenate([rims.craters for rims in alike]))
        variance += float(np.median(catalog.errors.size_share[shown])) ** 2
    return Growth(mean, variance**0.5)
