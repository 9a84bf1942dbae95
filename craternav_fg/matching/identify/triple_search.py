"""Hypotheses of the pose from triples of neighbouring rims, with position and attitude unknown."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.matching.identify.craters import Craters, density
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    PoseLimits,
    allowed,
    keep,
    size_sigma,
    size_sigmas,
    support,
)
from craternav_fg.matching.identify.kd_tree import Tree, nearest
from craternav_fg.matching.identify.nadir import place
from craternav_fg.matching.identify.triple_index import SIDE_UNIT, SIZE_UNIT, SMALLEST, describe
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

# Squared distance in the index, in standard deviations, up to which a triple of craters is a candidate: with
# five degrees of freedom, 97 % of the true ones.
_MAX_DISTANCE2 = 12.0
# Share of the index that is so near to a triple of rims, typically: it was 1e-5 to over 5e-3 for triples of
# five images. Where fewer are, each is the more significant. A factor e of it raises all scores by 1.
_TYPICAL_SHARE = 0.005
# Other rims after which a hypothesis with a score that is not positive is given up.
_PATIENCE = 3
# Least share of a disc around a rim that counts as shown in the image: bounds the estimate of how many
# neighbours are hidden.
_MIN_SHOWN = 0.05
# Points per ring by which that share is measured.
_RING_POINTS = 16
# Least cosine of the angle between a line of sight and the vertical in the correction of sizes.
_MIN_COS_SLANT = 0.1
# Relative error of a triple's sides besides the rims' noise: the sphere is not flat, nor the ground a sphere.
SIDE_ERROR = 0.02
# Share of the distance from a triple by which its pose predicts other rims wrongly.
LEVER = 0.05
# Density of craters somewhere over that of the whole body: so many neighbours do not show more than this.
_MAX_CROWDING = 10.0
# Factor from the noise of one centre to that of the distance between two.
PAIR_NOISE = 1.4
# Least ratio of twice a triple's area to the product of two sides: flatter triples give no rotation.
_MIN_SINE = 1e-3


class Projection(NamedTuple):
    """The n rims projected to the sphere under a hypothesis of vertical and altitude."""

    X: FloatArray
    """Positions of the rims' centres relative to the body's, in axes of c, m; NaN beside the body; (n, 3)."""
    log_size: FloatArray
    """Natural logarithms of the geometric means of the semi-axes, m; NaN beside the body; shape (n,)."""
    m_per_px: FloatArray
    """Extent of a pixel on the ground, across the mean of the foreshortening; shape (n,)."""
    down: FloatArray
    """Unit vector to the body's centre in c, shape (3,)."""
    range_m: float
    """Distance of the body's centre."""


def project_all_to_sphere(view: View, down: FloatArray, height_m: float, radius_m: float) -> Projection:
    """Project all rims of an image to the sphere.

    Parameters
    ----------
    view : View
    down : ndarray, shape (3,)
        Unit vector to the body's centre in c.
    height_m : float
        Altitude.
    radius_m : float
        The sphere's radius.

    Returns
    -------
    Projection
    """
    range_m = radius_m + height_m
    X, log_size, m_per_px = _project_all(view, down, range_m, radius_m)
    return Projection(X, log_size, m_per_px, down, range_m)


@njit(cache=True, error_model="numpy")
def _project_all(
    view: View, down: FloatArray, range_m: float, radius_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate `project_all_to_sphere`: positions, sizes and scales."""
    n = view.directions.shape[0]
    X = np.full((n, 3), np.nan)
    log_size = np.full(n, np.nan)
    m_per_px = np.full(n, np.nan)
    point = np.empty(3)
    for i in range(n):
        distance = place(view, i, down, range_m, radius_m, point)
        if distance < 0.0:
            continue
        cos = 0.0
        for k in range(3):
            X[i, k] = point[k]
            cos -= point[k] * view.directions[i, k] / radius_m
        cos = max(cos, _MIN_COS_SLANT)
        log_size[i] = view.log_angle[i] + np.log(distance) - 0.5 * np.log(cos)
        m_per_px[i] = distance / np.sqrt(cos) / view.focal_px
    return X, log_size, m_per_px


def largest(view: View, rims: IntArray, count: int) -> IntArray:
    """Select the largest rims.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (m,)
    count : int
        Largest number of them.

    Returns
    -------
    ndarray of int, shape (k,)
        In their order.
    """
    if len(rims) <= count:
        return rims
    return np.sort(rims[np.argsort(-view.radius_px[rims], kind="stable")[:count]])


def likeliest(view: View, rims: IntArray, count: int) -> IntArray:
    """Select the rims that are the likeliest craters.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (m,)
    count : int

    Returns
    -------
    ndarray of int, shape (k,)
        In their order, with others that are as likely.
    """
    if len(rims) <= count:
        return rims
    quality = view.quality[rims]
    return rims[quality >= np.partition(quality, -count)[-count]]


def likely_and_large(view: View, rims: IntArray, count: int) -> IntArray:
    """Select the rims with the largest products of probability and root of the radius.

    A larger power of the radius finds more craters of the map on real ground, and fewer among false rims that
    are as large.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (m,)
    count : int
        Largest number of them.

    Returns
    -------
    ndarray of int, shape (k,)
        In their order.
    """
    product = view.quality[rims] * np.sqrt(view.radius_px[rims])
    return np.sort(rims[np.argsort(-product, kind="stable")[:count]])


def image_order(view: View, rims: IntArray, count: int) -> Int32Array:
    """Order the rims around each rim by their distance in the image.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (m,)
        Rims among which neighbours are sought.
    count : int
        Largest number of neighbours per rim.

    Returns
    -------
    ndarray of int32, shape (n, l)
        Neighbours of each of the view's rims, nearest first: itself if it is one of `rims`.
    """
    order = _nearest(view.points_px, view.points_px[rims], min(count, len(rims)))
    return rims[order].astype(np.int32)


@njit(cache=True, error_model="numpy")
def _nearest(points: FloatArray, among: FloatArray, count: int) -> npt.NDArray[np.int64]:
    """Rows (n, count) of the points (m, 2) that are nearest to each of points (n, 2), nearest first."""
    out = np.zeros((len(points), count), dtype=np.int64)
    d2 = np.empty(count)
    for i in range(len(points)):
        d2[:] = np.inf
        for j in range(len(among)):
            away = (points[i, 0] - among[j, 0]) ** 2 + (points[i, 1] - among[j, 1]) ** 2
            k = count
            while k > 0 and away < d2[k - 1]:
                k -= 1
            if k < count:
                for later in range(count - 1, k, -1):
                    d2[later], out[i, later] = d2[later - 1], out[i, later - 1]
                d2[k], out[i, k] = away, j
    return out


def image_triples(view: View, projection: Projection, rims: IntArray, count: int, sigma: float) -> Int32Array:
    """Form triples of rims as the index forms triples of craters.

    Three things decide the order. The index holds a triple only when few craters are nearer to its first one;
    the share of the surroundings that the image shows tells how many may be hidden. A triple with small
    relative errors has fewer candidates. And all three rims must be craters.

    Parameters
    ----------
    view : View
    projection : Projection
    rims : ndarray of int, shape (r,)
        Rims of which triples are formed.
    count : int
        Neighbours of a rim that are paired.
    sigma : float
        Noise of the centres, px.

    Returns
    -------
    ndarray of int32, shape (m, 3)
        Rows of rims, the most promising triple first.
    """
    X, log_size, m_per_px = projection.X[rims], projection.log_size[rims], projection.m_per_px[rims]
    n = len(X)
    share = size_sigmas(view, sigma)[rims]
    near, d2 = _large_neighbours(X, log_size, log_size + np.log(SMALLEST) - share, min(count, n))
    first, second = np.triu_indices(near.shape[1], 1)
    i = np.repeat(np.arange(n), len(first))
    j, k = near[:, first].ravel(), near[:, second].ravel()
    to_j, to_k = np.sqrt(d2[:, first].ravel()), np.sqrt(d2[:, second].ravel())
    there = np.isfinite(to_j) & np.isfinite(to_k)
    i, j, k = i[there], j[there], k[there]
    perimeter = (to_j + to_k)[there]
    side = np.hypot(sigma * m_per_px[i] / perimeter, 0.5 * SIDE_ERROR)
    doubt = np.log(side * side * share[i] * share[j] * share[k])
    reach_px = np.sqrt(d2) / m_per_px[:, None]
    shown = _shown(view, rims, np.where(np.isfinite(reach_px), reach_px, 0.0))
    nearer = (np.arange(1, near.shape[1] + 1) / shown)[:, second].ravel()[there]
    triples = np.stack([i, j, k], axis=-1)
    doubt -= np.log(view.quality[rims])[triples].sum(axis=-1)
    triples = triples[np.argsort(doubt + nearer, kind="stable")]
    return rims[triples].astype(np.int32)


@njit(cache=True, error_model="numpy")
def _large_neighbours(
    X: FloatArray, log_size: FloatArray, least: FloatArray, count: int
) -> tuple[IntArray, FloatArray]:
    """Nearest places (n, count) of sizes at least `least` (n,), nearest first, and squared distances.

    Where there are fewer, the distance is infinite.
    """
    n = X.shape[0]
    near = np.zeros((n, count), dtype=np.int64)
    d2 = np.full((n, count), np.inf)
    for i in range(n):
        for j in range(n):
            x, y, z = X[i, 0] - X[j, 0], X[i, 1] - X[j, 1], X[i, 2] - X[j, 2]
            away = x * x + y * y + z * z
            if i == j or not log_size[j] >= least[i] or not 0.0 < away < d2[i, count - 1]:
                continue
            place = count - 1
            while place > 0 and d2[i, place - 1] > away:
                d2[i, place], near[i, place] = d2[i, place - 1], near[i, place - 1]
                place -= 1
            d2[i, place], near[i, place] = away, j
    return near, d2


def _shown(view: View, rims: IntArray, reach_px: FloatArray) -> FloatArray:
    """Share (r, m), at least `_MIN_SHOWN`, that the image shows of discs of radii (r, m) around some rims."""
    turn = 2.0 * np.pi * np.arange(_RING_POINTS) / _RING_POINTS
    # Two rings that stand for equal areas.
    ring = np.concatenate([np.sqrt(part) * np.exp(1j * turn) for part in (0.25, 0.75)])
    offset = reach_px[:, :, None] * ring
    at = view.points_px[rims, :, None, None]
    x, y = at[:, 0] + offset.real, at[:, 1] + offset.imag
    left, top, right, bottom = view.bounds_px
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    return np.maximum(inside.mean(axis=-1), _MIN_SHOWN)


@njit(cache=True, error_model="numpy")
def _pose_of(
    projection: Projection, centres: FloatArray, rims: Int32Array, triple: Int32Array, ratio: float,
    pose: FloatArray,
) -> bool:  # fmt: skip
    """Write the pose for which three projected rims, scaled by a ratio, lie on three craters.

    False when either triple is degenerate.
    """
    X = projection.X
    A = np.empty((3, 3))
    B = np.empty((3, 3))
    a0, b0 = np.zeros(3), np.zeros(3)
    sphere = 0.0
    for k in range(3):
        length = 0.0
        for r in range(3):
            # Relative to the camera: the altitude is what the ratio scales.
            a0[r] += ratio * (X[rims[k], r] + projection.range_m * projection.down[r]) / 3.0
            b0[r] += centres[triple[k], r] / 3.0
            length += centres[triple[k], r] ** 2
        sphere += np.sqrt(length) / 3.0
    for side in range(2):
        M = A if side == 0 else B
        for r in range(3):
            if side == 0:
                M[0, r] = X[rims[1], r] - X[rims[0], r]
                M[1, r] = X[rims[2], r] - X[rims[0], r]
            else:
                M[0, r] = centres[triple[1], r] - centres[triple[0], r]
                M[1, r] = centres[triple[2], r] - centres[triple[0], r]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            M[2, r] = M[0, s] * M[1, t] - M[0, t] * M[1, s]
        # A frame of the triangle's plane in which both sides count alike: along the bisector, and across it.
        l0 = np.sqrt(M[0, 0] ** 2 + M[0, 1] ** 2 + M[0, 2] ** 2)
        l1 = np.sqrt(M[1, 0] ** 2 + M[1, 1] ** 2 + M[1, 2] ** 2)
        l2 = np.sqrt(M[2, 0] ** 2 + M[2, 1] ** 2 + M[2, 2] ** 2)
        if not l2 > _MIN_SINE * l0 * l1:
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
        pose[CRATERS + k] = triple[k]
    return True


@njit(cache=True, error_model="numpy")
def _alike(found_d2: FloatArray, hits: int) -> float:
    """Estimate the number of the index' triples within the largest distance from the nearest `hits`."""
    if hits < found_d2.shape[0]:
        return max(hits, 1.0)
    # Their number grows with the volume in five dimensions.
    return hits * (_MAX_DISTANCE2 / max(found_d2[0], 1e-3)) ** 2.5


@njit(cache=True, error_model="numpy")
def _crowding(craters: Craters, neighbours: Int32Array, crater: int) -> float:
    """Estimate the density of craters around one, over the whole body's, by its neighbours in the index."""
    count = 0
    away2 = 0.0
    for k in range(neighbours.shape[1]):
        if neighbours[crater, k] < 0:
            break
        count += 1
        away2, range2 = 0.0, 0.0
        for r in range(3):
            away2 += (craters.centres[neighbours[crater, k], r] - craters.centres[crater, r]) ** 2
            range2 += craters.centres[crater, r] ** 2
        away2 /= range2
    least = craters.log_size[crater] + np.log(SMALLEST)
    expected = density(craters, least, np.inf) * np.pi * away2
    return min(max(count / expected, 1.0 / _MAX_CROWDING), _MAX_CROWDING) if expected > 0.0 else 1.0


@njit(cache=True, error_model="numpy")
def search_triples(
    view: View, index: SphereIndex, craters: Craters, neighbours: Int32Array, tree: Tree,
    projection: Projection, triples: Int32Array, order: Int32Array, sigma: float, asked_sigma: float,
    lever: float, candidates: int, limits: PoseLimits, best: FloatArray,
) -> None:  # fmt: skip
    """Look up triples of rims in the index and keep the best hypotheses.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    neighbours : ndarray of int32, shape (c, k)
        See `TripleIndex`.
    tree : Tree
        See `TripleIndex`.
    projection : Projection
    triples : ndarray of int32, shape (m, 3)
        Rows of rims, from `image_triples`.
    order : ndarray of int32, shape (n, l)
        From `image_order`.
    sigma : float
        Noise of the triples' centres, px.
    asked_sigma, lever : float
        Noise of the other rims' centres, px, and share of their distance, by which a pose is scored: see
        `hypothesis.support`.
    candidates : int
        Largest number of triples of craters that are examined per triple of rims.
    limits : PoseLimits
    best : ndarray, shape (h, HYPOTHESIS)
        Changed: the best hypothetical poses.
    """
    X, log_size, m_per_px = projection.X, projection.log_size, projection.m_per_px
    centres = craters.centres
    count = neighbours.shape[1]
    found_d2 = np.empty(candidates)
    found = np.empty(candidates, dtype=np.uint32)
    query = np.empty(5)
    weights = np.empty(5)
    rims = np.empty(3, dtype=np.int32)
    triple = np.empty(3, dtype=np.int32)
    pose = np.empty(HYPOTHESIS)
    for row in range(triples.shape[0]):
        for k in range(3):
            rims[k] = triples[row, k]
        swapped, perimeter = describe(X, log_size, rims[0], rims[1], rims[2], query)
        if swapped:
            rims[1], rims[2] = rims[2], rims[1]
        side = np.hypot(PAIR_NOISE * sigma * m_per_px[rims[0]] / perimeter, SIDE_ERROR)
        weights[0] = weights[1] = SIDE_UNIT / side
        for k in range(3):
            weights[2 + k] = SIZE_UNIT / np.hypot(size_sigma(view, rims[k], sigma), side)
        hits = nearest(tree, query, weights, _MAX_DISTANCE2, found_d2, found)
        rarity = -np.log(_alike(found_d2, hits) / (_TYPICAL_SHARE * tree.points.shape[0]))
        extent_px = perimeter / m_per_px[rims[0]] / 4.0
        for h in range(hits):
            code = np.int64(found[h])
            triple[0] = code // (count * count)
            triple[1] = neighbours[triple[0], (code // count) % count]
            triple[2] = neighbours[triple[0], code % count]
            if triple[1] < 0 or triple[2] < 0:
                # No index that was built here has such a code, but a file may.
                continue
            span = 0.0
            for k in range(3):
                total = 0.0
                for r in range(3):
                    total += (centres[triple[k], r] - centres[triple[(k + 1) % 3], r]) ** 2
                span += np.sqrt(total)
            if not _pose_of(projection, centres, rims, triple, span / perimeter, pose):
                continue
            if not allowed(pose, limits):
                continue
            crowding = _crowding(craters, neighbours, triple[0])
            score = support(
                view, index, craters, order[rims[0]], pose, extent_px, lever, asked_sigma, _PATIENCE, crowding
            )
            pose[SCORE] = score - 0.5 * found_d2[h] + rarity
            if pose[SCORE] > 0.0:
                keep(pose, best)
