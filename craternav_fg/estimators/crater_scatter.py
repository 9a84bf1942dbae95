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
    craters, errors, roots, white = _on_ground(frames, poses, camera, catalog)
    rows, index, counts = np.unique(craters, return_inverse=True, return_counts=True)
    n = len(rows)
    mean, root, spread = np.zeros((n, 5)), np.zeros((n, *roots.shape[1:])), np.zeros((n, 5, 5))
    np.add.at(mean, index, errors)
    np.add.at(root, index, roots)
    np.add.at(spread, index, white)
    # Of the mean over a crater's frames, in which white errors average out.
    root /= counts[:, None, None]
    covariance = root @ np.swapaxes(root, 1, 2) + spread / (counts**2)[:, None, None]
    distance2 = squared_distance(mean / counts[:, None], covariance)
    factors = (freedom + distance2) / (freedom + 5.0)
    return {int(row): float(f) for row, f in zip(rows, factors, strict=True) if f > 1.0}


def _on_ground(
    frames: Sequence[FrameMeasurement], poses: Sequence[FloatArray], camera: Camera, catalog: Catalog
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Errors of all rims in their planes, in radii, with what their craters keep.

    Returns
    -------
    craters, errors, roots, white : ndarray, shapes (n,), (n, 5), (n, 5, 21), (n, 5, 5)
        Roots of the parts of the covariance that are not white, see `RimSet.kept`, and its white part.
    """
    parts = []
    for frame, gTb in zip(frames, poses, strict=True):
        rims, pose = frame.rims, np.ascontiguousarray(gTb)
        if rims.correlated is None and rims.of_map is None:
            continue
        centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
        charts, seen = project_rims(pose, camera.bTc, centres, axes)
        slopes = ground_slopes(pose, camera.bTc, centres, axes)[seen][:, :, _IN_PLANE]
        inverse = np.linalg.inv(slopes)
        # Frames may differ in the parts that they state.
        roots = np.zeros((int(seen.sum()), 5, sum(_SIZES)))
        parts_of_rims = np.split(roots, np.cumsum(_SIZES)[:-1], axis=2)
        columns = (slice(0, CORRELATED_SIZE), rims.map_columns, slice(0, SHARED_SIZE))
        for A, part, own in zip(rims.kept, parts_of_rims, columns, strict=True):
            if A is not None:
                part[:, :, own] = A[seen]
        white = rims.fused_white_covariance[seen]
        parts.append(
            (
                rims.craters[seen],
                (inverse @ (rims.chart - charts)[seen][:, :, None])[:, :, 0],
                inverse @ roots,
                inverse @ white @ np.swapaxes(inverse, 1, 2),
            )
        )
    if not parts:
        return np.empty(0, np.int64), np.empty((0, 5)), np.empty((0, 5, 1)), np.empty((0, 5, 5))
    craters, errors, roots_, white_ = (np.concatenate(one) for one in zip(*parts, strict=True))
    return craters, errors, roots_, white_


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
