"""Edge points of rims of which only a part is seen: cut by the image's border, or half in shadow.

They are judged against the rim that the pose of the whole rims predicts, and leave as points: an ellipse
through so little of a rim would be arbitrary.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.vision import ellipse_kernel

FloatArray = npt.NDArray[np.float64]

_MAD_TO_SIGMA = 1.4826
# Points further than this from the others, in standard deviations, are other edges'.
_OUTLIER_SIGMAS = 3.5
# Error of points on fine rims, px, that their own scatter may understate.
_MIN_SCATTER_PX = 0.1


@dataclass(frozen=True)
class ArcOptions:
    """Which arcs are believed.

    Attributes
    ----------
    min_points : int
        Fewer edge points are none.
    min_found_share : float
        Least share of the searched normals with an edge.
    max_rms_px, max_rms_share : float
        Largest scatter of the points about a smooth line along the rim: max_rms_px + max_rms_share b.
    shared_px : float
        Standard deviation of an error that an arc's points share in one frame.
    gate : float
        Largest distance of an arc from its prediction, in standard deviations of both.
    margin_px : float
        Rims are looked at as long as no part of them is further outside the image.
    """

    min_points: int = 12
    min_found_share: float = 0.7
    max_rms_px: float = 0.4
    max_rms_share: float = 0.03
    shared_px: float = 0.06
    gate: float = 3.5
    margin_px: float = 400.0


def judge(
    points_px: FloatArray,
    ratio: FloatArray,
    chart_px: FloatArray,
    minor_px: float,
    lasting_px: float,
    predicted_px: float,
    options: ArcOptions,
) -> tuple[FloatArray, FloatArray] | None:
    """Keep the points of one arc that belong to its rim.

    Parameters
    ----------
    points_px : ndarray, shape (n, 2)
    ratio : ndarray, shape (n,)
        As `edges.trace_rim` gives it.
    chart_px : ndarray, shape (5,)
        Predicted rim.
    minor_px : float
        Its semi-minor axis.
    lasting_px : float
        Standard deviation of an error that all points of the arc share and that lasts.
    predicted_px : float
        Standard deviation of the prediction there.
    options : ArcOptions

    Returns
    -------
    points_px : ndarray, shape (m, 2)
    sigma_px : ndarray, shape (m,)
        Without what lasts, as if the points' errors were independent: their mean is as uncertain as it is.
    None
        When they are no arc of that rim.
    """
    if len(points_px) < options.min_points:
        return None
    distance, along = np.empty(len(points_px)), np.empty(len(points_px))
    normal, derivative = np.empty(2), np.empty(5)
    for i, (x, y) in enumerate(points_px):
        distance[i] = ellipse_kernel.signed_distance(x, y, chart_px, normal, derivative)
        along[i] = np.arctan2(normal[1], normal[0])
    # Angles along the arc, from its middle.
    along = np.angle(np.exp(1j * (along - np.angle(np.mean(np.exp(1j * along))))))
    line = np.stack([np.ones_like(along), along, along**2], axis=1)
    kept, scatter, smooth = np.ones(len(distance), dtype=np.bool_), 0.0, distance
    for _ in range(5):
        A = line[kept] / ratio[kept, None]
        smooth = line @ np.linalg.lstsq(A, distance[kept] / ratio[kept], rcond=None)[0]
        off = (distance - smooth) / ratio
        least = _MIN_SCATTER_PX / float(np.mean(ratio))
        scatter = max(_MAD_TO_SIGMA * float(np.median(np.abs(off[kept]))), least)
        kept = np.abs(off) < _OUTLIER_SIGMAS * scatter
        if np.count_nonzero(kept) < options.min_points:
            return None
    own = scatter * ratio[kept]
    if np.sqrt(np.mean(own**2)) > options.max_rms_px + options.max_rms_share * minor_px:
        return None
    count = int(np.count_nonzero(kept))
    # Curvature and slope of the misfit are as telling as its mean.
    misfit = np.sqrt(np.mean(smooth[kept] ** 2))
    if misfit > options.gate * np.sqrt(lasting_px**2 + predicted_px**2 + np.mean(own**2) / count):
        return None
    return points_px[kept], np.sqrt(own**2 + count * options.shared_px**2)
