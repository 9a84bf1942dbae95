"""Craters whose rims err by more than they state: larger variances, so that no single crater decides.

What a crater keeps over its frames is not normally distributed: of a published map, and of rims on real
ground, some are misplaced by many standard deviations. A loss on each frame's residual does not see that, as
a variable of the graph takes up the error. So these errors are taken to follow Student's t distribution: a
normal one whose variance differs from crater to crater. Its expectation, given the residuals of a first
optimum, is the variance with which the final one is computed (one iteration of expectation-maximisation). No
variance is made smaller than stated: a rim that fits by chance is not a better one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import CORRELATED_SIZE, MAP_SIZE, SHARED_SIZE, TILT_SIZE, FrameMeasurement
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes

# Columns of `ground_slopes` that move a rim within its plane.
_IN_PLANE = [0, 1, 3, 4, 5]
# Columns of the roots of `RimSet.kept`, at most.
_SIZES = (CORRELATED_SIZE, MAP_SIZE + TILT_SIZE, SHARED_SIZE)


def variance_factors(
    frames: Sequence[FrameMeasurement],
    poses: Sequence[FloatArray],
    camera: Camera,
    catalog: Catalog,
    freedom: float,
) -> dict[int, float]:
    """Compute by how much the rims of some craters err more than they state.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    poses : sequence of ndarray, shape (4, 4)
        Poses gTb of the body, in g, m, of an optimum on these frames.
    camera : Camera
    catalog : Catalog
    freedom : float
        Degrees of freedom of Student's t distribution.

    Returns
    -------
    dict of int to float
        Variance factors above 1 by row of the catalogue. Craters without one are as good as stated, or have
        no errors that they keep.

    References
    ----------
    Lange, Little, Taylor, J. American Statistical Association 84 (1989) 881,
    DOI 10.1080/01621459.1989.10478852.
    """
    craters, slopes, errors, roots, white = _in_image(frames, poses, camera, catalog)
    rows, index, counts = np.unique(craters, return_inverse=True, return_counts=True)
    errors, roots, spread = _means_on_ground(index, counts, np.linalg.inv(slopes), errors, roots, white)
    distance2 = squared_distance(errors, roots @ np.swapaxes(roots, 1, 2) + spread)
    factors = (freedom + distance2) / (freedom + 5.0)
    return {int(row): float(f) for row, f in zip(rows, factors, strict=True) if f > 1.0}


def _in_image(
    frames: Sequence[FrameMeasurement], poses: Sequence[FloatArray], camera: Camera, catalog: Catalog
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors of all rims that their poses see, with what their craters keep.

    Returns
    -------
    craters, slopes, errors, roots, white : ndarray, shapes (n,), (n, 5, 5), (n, 5), (n, 5, 21), (n, 5, 5)
        Derivatives of the charts in errors within the rims' planes, in radii; errors of the charts, roots of
        the parts of their covariance that are not white, see `RimSet.kept`, and its white part.
    """
    known = [
        (frame.rims, np.ascontiguousarray(gTb))
        for frame, gTb in zip(frames, poses, strict=True)
        if frame.rims.correlated is not None or frame.rims.of_map is not None
    ]
    begins = np.cumsum([0, *(len(rims) for rims, _ in known)])
    craters, visible = np.empty(begins[-1], dtype=np.int64), np.empty(begins[-1], dtype=np.bool_)
    slopes, errors = np.empty((begins[-1], 5, 5)), np.empty((begins[-1], 5))
    # Frames may differ in the parts that they state.
    roots, white = np.zeros((begins[-1], 5, sum(_SIZES))), np.empty((begins[-1], 5, 5))
    parts = np.split(roots, np.cumsum(_SIZES)[:-1], axis=2)
    for (rims, gTb), begin, end in zip(known, begins[:-1], begins[1:], strict=True):
        own = slice(begin, end)
        centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
        charts, visible[own] = project_rims(gTb, camera.bTc, centres, axes)
        slopes[own] = ground_slopes(gTb, camera.bTc, centres, axes)[:, :, _IN_PLANE]
        craters[own], errors[own], white[own] = rims.craters, rims.chart - charts, rims.fused_white_covariance
        columns = (slice(0, CORRELATED_SIZE), rims.map_columns, slice(0, SHARED_SIZE))
        for A, part, of_part in zip(rims.kept, parts, columns, strict=True):
            if A is not None:
                part[own, :, of_part] = A
    return craters[visible], slopes[visible], errors[visible], roots[visible], white[visible]


@njit(cache=True, error_model="numpy")
def _means_on_ground(
    index: IntArray, counts: IntArray, inverse: FloatArray, errors: FloatArray, roots: FloatArray,
    white: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Average the errors of each crater over its frames, and what they keep; white errors average out.

    Takes the craters (n,) of the rims and what `_in_image` gives, with its slopes inverted; returns the mean
    errors (k, 5) within the rims' planes, in radii, the mean roots (k, 5, 21) and the covariance (k, 5, 5)
    that is left of white errors.
    """
    k, m = len(counts), roots.shape[2]
    mean, root, spread = np.zeros((k, 5)), np.zeros((k, 5, m)), np.zeros((k, 5, 5))
    half = np.empty(5)
    for n in range(len(index)):
        c, G = index[n], inverse[n]
        share = 1.0 / counts[c]
        for i in range(5):
            half[:] = 0.0
            for j in range(5):
                g = share * G[i, j]
                mean[c, i] += g * errors[n, j]
                for q in range(m):
                    root[c, i, q] += g * roots[n, j, q]
                for q in range(5):
                    half[q] += g * white[n, j, q]
            for j in range(5):
                for q in range(5):
                    spread[c, i, j] += half[q] * share * G[j, q]
    return mean, root, spread


def with_variance_factors(frame: FrameMeasurement, factors: dict[int, float]) -> FrameMeasurement:
    """Multiply the variances of a frame's rims by the factors of their craters.

    Parameters
    ----------
    frame : FrameMeasurement
    factors : dict of int to float
        See `variance_factors`; 1 for other craters.

    Returns
    -------
    FrameMeasurement
    """
    of_rims = np.array([factors.get(crater, 1.0) for crater in frame.rims.craters.tolist()])
    if (of_rims == 1.0).all():
        return frame
    return replace(frame, rims=frame.rims.scaled(of_rims))
