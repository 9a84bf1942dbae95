"""Arcs: edge points of rims of which only a part is seen, cut by the image's border or half in shadow.

They are judged against the rim that the pose of the whole rims predicts, and are measured as points: an
ellipse through so little of a rim would be arbitrary.
"""

from dataclasses import dataclass

import numpy as np

from craternav_fg.ellipse_distance import signed_distances
from craternav_fg.vision.edges import EdgePoints
from craternav_fg.vision.robust_scale import robust_sigma
from factors.arrays import FloatArray

# Points farther from the smooth line along the arc, in standard deviations, belong to another edge.
_OUTLIER_SIGMAS = 3.5
# Minimum standard deviation of the points, px: the scatter of few points on a fine rim understates it.
_MIN_SCATTER_PX = 0.1
# Rounds of outlier rejection: the kept points no longer change.
_REJECTION_ROUNDS = 5


@dataclass(frozen=True)
class ArcOptions:
    """Which arcs are accepted.

    Attributes
    ----------
    min_points : int
        Minimum number of edge points.
    min_found_share : float
        Minimum share of the searched normals with an edge.
    max_rms_px, max_rms_share : float
        Largest scatter of the points about a smooth line along the rim: max_rms_px + max_rms_share b, b the
        semi-minor axis.
    shared_px : float
        Standard deviation of an error that an arc's points share in one frame.
    gate_sigmas : float
        Largest distance of an arc from its prediction, in standard deviations of both.
    margin_px : float
        Rims are traced as long as no part of them is farther than this outside the image.
    """

    min_points: int = 12
    min_found_share: float = 0.7
    max_rms_px: float = 0.4
    max_rms_share: float = 0.03
    shared_px: float = 0.06
    gate_sigmas: float = 3.5
    margin_px: float = 400.0


def across_sigma(points: FloatArray, chart: FloatArray, covariance: FloatArray) -> float:
    """Compute how far a rim that is off moves across its outline, where points of an arc are.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Points along the rim, in pixels or in normalised image coordinates.
    chart : ndarray, shape (5,)
        Chart of the rim in the same unit.
    covariance : ndarray, shape (5, 5)
        Covariance of the chart.

    Returns
    -------
    float
        Root mean square over the points of the standard deviation along the rim's normal; 0 without points.
    """
    if len(points) == 0:
        return 0.0
    _, _, derivatives = signed_distances(points, chart)
    return float(np.sqrt(np.mean(np.sum(derivatives @ covariance * derivatives, axis=1))))


def judge(
    edges: EdgePoints,
    chart_px: FloatArray,
    minor_px: float,
    correlated_px: float,
    predicted_px: float,
    options: ArcOptions,
) -> tuple[FloatArray, FloatArray] | None:
    """Keep the points of one arc that belong to its rim.

    Parameters
    ----------
    edges : EdgePoints
        n points.
    chart_px : ndarray, shape (5,)
        Predicted rim, chart in pixels.
    minor_px : float
        Its semi-minor axis.
    correlated_px : float
        Standard deviation of the time-correlated error that all points of the arc share.
    predicted_px : float
        Standard deviation of the prediction.
    options : ArcOptions

    Returns
    -------
    points_px : ndarray, shape (m, 2)
        The points that belong to the rim.
    sigma_px : ndarray, shape (m,)
        Standard deviations as if the points' white errors were independent, so large that the mean of the
        points has the right one. Without the time-correlated error.
    None
        When the points are no arc of that rim.
    """
    points, ratio = edges.points_px, edges.sigma_ratio
    if len(points) < options.min_points:
        return None
    distance, normals, _ = signed_distances(points, chart_px)
    # Angles of the normals, from the middle of the arc.
    turns = normals[:, 0] + 1j * normals[:, 1]
    along = np.angle(turns * np.conj(turns.mean()))
    line = np.stack([np.ones_like(along), along, along**2], axis=1)
    kept, scatter, smooth = np.ones(len(distance), dtype=np.bool_), 0.0, distance
    for _ in range(_REJECTION_ROUNDS):
        A = line[kept] / ratio[kept, None]
        smooth = line @ np.linalg.lstsq(A, distance[kept] / ratio[kept], rcond=None)[0]
        off = (distance - smooth) / ratio
        least = _MIN_SCATTER_PX / float(np.mean(ratio))
        scatter = max(robust_sigma(off[kept]), least)
        kept = np.abs(off) < _OUTLIER_SIGMAS * scatter
        if np.count_nonzero(kept) < options.min_points:
            return None
    own = scatter * ratio[kept]
    if np.sqrt(np.mean(own**2)) > options.max_rms_px + options.max_rms_share * minor_px:
        return None
    count = int(np.count_nonzero(kept))
    # Slope and curvature of the misfit show a wrong rim as well as its mean does.
    misfit = np.sqrt(np.mean(smooth[kept] ** 2))
    if misfit > options.gate_sigmas * np.sqrt(correlated_px**2 + predicted_px**2 + np.mean(own**2) / count):
        return None
    return points[kept], np.sqrt(own**2 + count * options.shared_px**2)
