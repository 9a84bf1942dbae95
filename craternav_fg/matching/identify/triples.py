"""Hypotheses of the pose from triples of neighbouring rims: position and attitude unknown."""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    axis_share,
    axis_shares,
    keep,
    support,
)
from craternav_fg.matching.identify.nadir import place
from craternav_fg.matching.identify.tree import nearest
from craternav_fg.matching.identify.triple_index import SIDE_UNIT, SIZE_UNIT, SMALLEST, describe
from craternav_fg.matching.identify.view import View

FloatArray = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

_REACH2 = 12.0
# Rims that may be asked in vain.
_PATIENCE = 3
_LEAST_SHOWN = 0.05


@njit(cache=True, error_model="numpy")
def project_all_to_sphere(
    view: View, down: FloatArray, height_m: float, radius_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places of the rims under a model of the view.

    Returns
    -------
    X : ndarray, shape (n, 3)
        From the body's centre, in the camera's axes, m; NaN beside the body.
    log_sizes : ndarray, shape (n,)
        Of semi-axes in m.
    scale : ndarray, shape (n,)
        Metres on the ground of a pixel, across the foreshortening's mean.
    """
    n = view.directions.shape[0]
    X = np.full((n, 3), np.nan)
    log_sizes = np.full(n, np.nan)
    scale = np.full(n, np.nan)
    point = np.empty(3)
    for i in range(n):
        distance = place(view, i, down, radius_m + height_m, radius_m, point)
        if distance < 0.0:
            continue
        cos = 0.0
        for k in range(3):
            X[i, k] = point[k]
            cos -= point[k] * view.directions[i, k] / radius_m
        cos = max(cos, 0.1)
        log_sizes[i] = view.log_angle[i] + np.log(distance) - 0.5 * np.log(cos)
        scale[i] = distance / np.sqrt(cos) / view.focal_px
    return X, log_sizes, scale


def image_order(view: View, count: int) -> Int32Array:
    """Of each rim (n, m) itself and its nearest others in the image, nearest first, at most `count`."""
    p = view.points_px
    d2 = np.sum((p[:, None] - p[None]) ** 2, axis=-1)
    return np.argsort(d2, axis=1)[:, :count].astype(np.int32)


def image_triples(
    X: FloatArray, log_sizes: FloatArray, scale: FloatArray, view: View, count: int, sigma: float
) -> Int32Array:
    """Triples (m, 3) of rims as the catalogue has them; first those that the index has and that say most.

    The index has a triple when no more than a few craters are nearer to its first than the others are. How
    many are, an image tells as far as it shows the ground around that.

    Parameters
    ----------
    X, log_sizes, scale
        From `project_all_to_sphere`.
    view : View
    count : int
        Neighbours of a rim.
    sigma : float
        Noise, px.
    """
    n = len(X)
    share = axis_shares(view, sigma)
    d2 = np.sum((X[:, None] - X[None]) ** 2, axis=-1)
    large = log_sizes[None] >= (log_sizes + np.log(SMALLEST) - share)[:, None]
    d2[~large | np.eye(n, dtype=bool) | ~(d2 > 0.0)] = np.inf
    near = np.argsort(d2, axis=1)[:, :count]
    first, second = np.triu_indices(near.shape[1], 1)
    i = np.repeat(np.arange(n), len(first))
    j, k = near[:, first].ravel(), near[:, second].ravel()
    there = np.isfinite(d2[i, j]) & np.isfinite(d2[i, k])
    i, j, k = i[there], j[there], k[there]
    perimeter = np.sqrt(d2[i, j]) + np.sqrt(d2[i, k])
    side = np.hypot(sigma * scale[i] / perimeter, 0.01)
    doubt = np.log(side * side * share[i] * share[j] * share[k])
    reach_px = np.sqrt(np.take_along_axis(d2, near, axis=1)) / scale[:, None]
    shown = _shown(view, np.where(np.isfinite(reach_px), reach_px, 0.0))
    nearer = (np.arange(1, near.shape[1] + 1) / shown)[:, second].ravel()[there]
    return np.stack([i, j, k], axis=-1)[np.argsort(doubt + nearer, kind="stable")].astype(np.int32)


def _shown(view: View, reach_px: FloatArray) -> FloatArray:
    """Share (n, m) of the discs of some radii (n, m) around each rim that the image shows, 0.05 at least."""
    turn = 2.0 * np.pi * np.arange(16) / 16
    # Two rings of the same area each.
    ring = np.concatenate([np.sqrt(part) * np.exp(1j * turn) for part in (0.25, 0.75)])
    offset = reach_px[:, :, None] * ring
    x, y = view.points_px[:, 0, None, None] + offset.real, view.points_px[:, 1, None, None] + offset.imag
    left, top, right, bottom = view.corners
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    return np.maximum(inside.mean(axis=-1), _LEAST_SHOWN)


@njit(cache=True, error_model="numpy")
def _pose_of(
    view: View, X: FloatArray, centres: FloatArray, down: FloatArray, height_m: float, radius_m: float,
    rims: Int32Array, craters: Int32Array, ratio: float, pose: FloatArray,
) -> bool:  # fmt: skip
    """Write the pose that turns and scales a triple of a view's model into a triple of craters."""
    A = np.empty((3, 3))
    B = np.empty((3, 3))
    a0, b0 = np.zeros(3), np.zeros(3)
    sphere = 0.0
    for k in range(3):
        length = 0.0
        for r in range(3):
            # From the camera: what the altitude scales.
            a0[r] += ratio * (X[rims[k], r] + (radius_m + height_m) * down[r]) / 3.0
            b0[r] += centres[craters[k], r] / 3.0
            length += centres[craters[k], r] ** 2
        sphere += np.sqrt(length) / 3.0
    for side in range(2):
        M = A if side == 0 else B
        for r in range(3):
            if side == 0:
                M[0, r] = X[rims[1], r] - X[rims[0], r]
                M[1, r] = X[rims[2], r] - X[rims[0], r]
            else:
                M[0, r] = centres[craters[1], r] - centres[craters[0], r]
                M[1, r] = centres[craters[2], r] - centres[craters[0], r]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            M[2, r] = M[0, s] * M[1, t] - M[0, t] * M[1, s]
        # A frame of the plane that treats both sides alike: their sum of unit vectors, and across it.
        l0 = np.sqrt(M[0, 0] ** 2 + M[0, 1] ** 2 + M[0, 2] ** 2)
        l1 = np.sqrt(M[1, 0] ** 2 + M[1, 1] ** 2 + M[1, 2] ** 2)
        l2 = np.sqrt(M[2, 0] ** 2 + M[2, 1] ** 2 + M[2, 2] ** 2)
        if not l2 > 1e-3 * l0 * l1:
            return False
        total = 0.0
        for r in range(3):
            M[0, r] = M[0, r] / l0 + M[1, r] / l1
            M[2, r] /= l2
            total += M[0, r] ** 2
        for r in range(3):
            M[0, r] /= np.sqrt(total)
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            M[1, r] = M[2, s] * M[0, t] - M[2, t] * M[0, s]
    for r in range(3):
        for c in range(3):
            value = 0.0
            for k in range(3):
                value += B[k, r] * A[k, c]
            pose[ROTATION + 3 * r + c] = value
    for r in range(3):
        pose[POSITION + r] = b0[r]
        for c in range(3):
            pose[POSITION + r] -= pose[ROTATION + 3 * r + c] * a0[c]
    pose[SPHERE] = sphere
    for k in range(3):
        pose[RIMS + k] = rims[k]
        pose[CRATERS + k] = craters[k]
    return True


@njit(cache=True, error_model="numpy")
def agrees(pose: FloatArray, attitude: FloatArray, least_cos: float, least_m: float, most_m: float) -> bool:
    """Whether a pose is at an altitude that is allowed, and turned as is known.

    `attitude` (3, 3) is gRc, or of no rows when nothing is known; `least_cos` the largest angle's cosine.
    """
    range2 = 0.0
    for r in range(3):
        range2 += pose[POSITION + r] ** 2
    altitude = np.sqrt(range2) - pose[SPHERE]
    if not least_m < altitude < most_m:
        return False
    trace = 0.0
    for r in range(attitude.shape[0]):
        for c in range(3):
            trace += attitude[r, c] * pose[ROTATION + 3 * r + c]
    return attitude.shape[0] == 0 or 0.5 * (trace - 1.0) >= least_cos


@njit(cache=True, error_model="numpy")
def search(
    view: View, index: SphereIndex, craters: Craters, neighbours: Int32Array, points: npt.NDArray[np.uint16],
    codes: npt.NDArray[np.uint32], dims: npt.NDArray[np.uint8], splits: npt.NDArray[np.uint16], levels: int,
    X: FloatArray, log_sizes: FloatArray, scale: FloatArray, triples: Int32Array, order: Int32Array,
    down: FloatArray, height_m: float, radius_m: float, sigma: float, warp: float, lever: float,
    candidates: int, attitude: FloatArray, least_cos: float, least_m: float, most_m: float, best: FloatArray,
) -> None:  # fmt: skip
    """Look up triples of rims and keep the best hypotheses.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    neighbours, points, codes, dims, splits, levels
        The index' triples.
    X, log_sizes, scale, down, height_m, radius_m
        The model of the view, from `project_all_to_sphere`.
    triples : ndarray of int32, shape (m, 3)
        To look up.
    order : ndarray of int32, shape (n, k)
        From `image_order`.
    sigma : float
        Noise, px.
    warp, lever : float
        Relative error of sides by the model; that of places far from a triple.
    candidates : int
        Triples of craters to judge at most for each.
    attitude, least_cos, least_m, most_m
        See `agrees`.
    best : ndarray, shape (k, HYPOTHESIS)
        Kept here.
    """
    count = neighbours.shape[1]
    found_d2 = np.empty(candidates)
    found = np.empty(candidates, dtype=np.uint32)
    query = np.empty(5)
    weights = np.empty(5)
    rims = np.empty(3, dtype=np.int32)
    triple = np.empty(3, dtype=np.int32)
    centres = craters.centres
    pose = np.empty(HYPOTHESIS)
    for row in range(triples.shape[0]):
        for k in range(3):
            rims[k] = triples[row, k]
        swapped, perimeter = describe(X, log_sizes, rims[0], rims[1], rims[2], query)
        if swapped:
            rims[1], rims[2] = rims[2], rims[1]
        side = np.hypot(1.4 * sigma * scale[rims[0]] / perimeter, warp)
        weights[0] = weights[1] = SIDE_UNIT / side
        for k in range(3):
            weights[2 + k] = SIZE_UNIT / np.hypot(axis_share(view, rims[k], sigma), side)
        hits = nearest(points, codes, dims, splits, levels, query, weights, _REACH2, found_d2, found)
        extent = perimeter / scale[rims[0]] / 4.0
        for h in range(hits):
            code = np.int64(found[h])
            triple[0] = code // (count * count)
            triple[1] = neighbours[triple[0], (code // count) % count]
            triple[2] = neighbours[triple[0], code % count]
            span = 0.0
            for k in range(3):
                total = 0.0
                for r in range(3):
                    total += (centres[triple[k], r] - centres[triple[(k + 1) % 3], r]) ** 2
                span += np.sqrt(total)
            if not _pose_of(
                view, X, centres, down, height_m, radius_m, rims, triple, span / perimeter, pose
            ) or not agrees(pose, attitude, least_cos, least_m, most_m):
                continue
            score = support(view, index, craters, order[rims[0]], pose, extent, lever, sigma, 14, _PATIENCE)
            pose[SCORE] = score - 0.5 * found_d2[h]
            if pose[SCORE] > 0.0:
                keep(pose, best)
