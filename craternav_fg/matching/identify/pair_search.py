"""Hypotheses of the pose from pairs of rims, with the vertical given and position and azimuth unknown.

The index holds triples of neighbours. Where a map has many craters of which an image shows few, hardly any
two neighbours of a crater are shown, but many pairs of large rims are. All pairs of craters whose sizes over
their distance are those of a pair of rims are tried: the larger the rims over their distance, the fewer.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.matching.identify.craters import Craters
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
    support,
)
from craternav_fg.matching.identify.triple_search import LEVER, PAIR_NOISE, SIDE_ERROR, Projection
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

# Gate on the squared error of a pair's two sizes, over its distance: 99 % of true pairs pass.
_GATE2 = 9.0
# Other rims after which a hypothesis with a score that is not positive is given up.
_PATIENCE = 3.0
# Craters around one among which its partner is sought, at most.
_PARTNERS = 512


def image_pairs(view: View, projection: Projection, rims: IntArray) -> Int32Array:
    """Form pairs of rims, those first that are likely craters and large over their distance.

    Parameters
    ----------
    view : View
    projection : Projection
    rims : ndarray of int, shape (r,)

    Returns
    -------
    ndarray of int32, shape (m, 2)
        Rows of rims, the larger one first.
    """
    rims = rims[np.isfinite(projection.log_size[rims])]
    rims = rims[np.argsort(-projection.log_size[rims], kind="stable")]
    i, j = np.triu_indices(len(rims), 1)
    apart2 = np.sum((projection.X[rims[i]] - projection.X[rims[j]]) ** 2, axis=1)
    sizes = np.exp(projection.log_size[rims[i]] + projection.log_size[rims[j]])
    # Pairs of craters that are tried, over the probability that the pair is one.
    effort = apart2 / (sizes * view.quality[rims[i]] * view.quality[rims[j]])
    order = np.argsort(effort, kind="stable")
    order = order[apart2[order] > 0.0]
    return np.stack([rims[i[order]], rims[j[order]]], axis=-1).astype(np.int32)


@njit(cache=True, error_model="numpy")
def search_pair(
    view: View, index: SphereIndex, craters: Craters, projection: Projection, radius_m: float,
    pair: Int32Array, order: Int32Array, sigma: float, limits: PoseLimits, most: int, best: FloatArray,
) -> int:  # fmt: skip
    """Try the pairs of craters for a pair of rims and keep the best hypotheses.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    projection : Projection
    radius_m : float
        The sphere's radius.
    pair : ndarray of int32, shape (2,)
        Rows of the rims.
    order : ndarray of int32, shape (n, l)
        From `triple_search.image_order`.
    sigma : float
        Noise of the centres, px.
    limits : PoseLimits
    most : int
        Number of pairs of craters after which the search ends.
    best : ndarray, shape (h, HYPOTHESIS)
        Changed: the best hypothetical poses.

    Returns
    -------
    int
        Pairs of craters that were tried.
    """
    a, b = pair[0], pair[1]
    X, log_size = projection.X, projection.log_size
    apart, apart_px2 = 0.0, 0.0
    for r in range(3):
        apart += (X[a, r] - X[b, r]) ** 2
    for r in range(2):
        apart_px2 += (view.points_px[a, r] - view.points_px[b, r]) ** 2
    apart = np.sqrt(apart)
    side = np.hypot(PAIR_NOISE * sigma * projection.m_per_px[a] / apart, SIDE_ERROR)
    sigma_a = np.hypot(size_sigma(view, a, sigma), side)
    sigma_b = np.hypot(size_sigma(view, b, sigma), side)
    gate = np.sqrt(_GATE2)
    slack_a, slack_b = gate * sigma_a, gate * np.hypot(sigma_a, sigma_b)
    height_m = projection.range_m - radius_m
    lowest = np.log(limits.min_altitude_m / height_m) - slack_a
    highest = np.log(limits.max_altitude_m / height_m) + slack_a
    found = np.empty(_PARTNERS, dtype=np.int64)
    A, B = np.empty((3, 3)), np.empty((3, 3))
    pose = np.empty(HYPOTHESIS)
    _axes(X[a], X[b], A)
    tried = 0
    for c in range(craters.centres.shape[0]):
        # Scale of the image's ground, as the first crater's size shows it.
        scale = craters.log_size[c] - log_size[a]
        if not lowest < scale < highest:
            continue
        sphere = np.sqrt(craters.centres[c, 0] ** 2 + craters.centres[c, 1] ** 2 + craters.centres[c, 2] ** 2)
        half_chord = 0.5 * apart * np.exp(scale + slack_a) / sphere
        if half_chord > 0.5:
            continue
        count = within(
            index, craters.centres[c, 0] / sphere, craters.centres[c, 1] / sphere,
            craters.centres[c, 2] / sphere, 2.0 * np.arcsin(half_chord),
            log_size[b] + scale - slack_b, log_size[b] + scale + slack_b, found,
        )  # fmt: skip
        for d in found[:count]:
            if d == c:
                continue
            span = 0.0
            for r in range(3):
                span += (craters.centres[c, r] - craters.centres[d, r]) ** 2
            ratio = np.sqrt(span) / apart
            log_ratio = np.log(ratio)
            error2 = ((scale - log_ratio) / sigma_a) ** 2
            error2 += ((craters.log_size[d] - log_size[b] - log_ratio) / sigma_b) ** 2
            if not error2 < _GATE2:
                continue
            tried += 1
            _axes(craters.centres[c], craters.centres[d], B)
            _set_pose(projection, a, b, craters.centres[c], craters.centres[d], A, B, ratio, pose)
            pose[RIMS], pose[RIMS + 1], pose[RIMS + 2] = a, b, -1.0
            pose[CRATERS], pose[CRATERS + 1], pose[CRATERS + 2] = c, d, -1.0
            if not allowed(pose, limits):
                continue
            score = support(
                view, index, craters, order[a], pose, 0.5 * np.sqrt(apart_px2), LEVER, sigma, _PATIENCE, 1.0
            )
            pose[SCORE] = score - 0.5 * error2
            if pose[SCORE] > 0.0:
                keep(pose, best)
        if tried >= most:
            break
    return tried


@njit(cache=True, error_model="numpy")
def _axes(first: FloatArray, second: FloatArray, out: FloatArray) -> None:
    """Write unit vectors along a line between two places (3,), across it, and upwards, as rows (3, 3)."""
    along2, up2, product = 0.0, 0.0, 0.0
    for r in range(3):
        out[0, r] = second[r] - first[r]
        out[2, r] = first[r] + second[r]
        along2 += out[0, r] ** 2
    for r in range(3):
        out[0, r] /= np.sqrt(along2)
    for r in range(3):
        product += out[0, r] * out[2, r]
    for r in range(3):
        out[2, r] -= product * out[0, r]
        up2 += out[2, r] ** 2
    for r in range(3):
        out[2, r] /= np.sqrt(up2)
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        out[1, r] = out[2, s] * out[0, t] - out[2, t] * out[0, s]


@njit(cache=True, error_model="numpy")
def _set_pose(
    projection: Projection, a: int, b: int, first: FloatArray, second: FloatArray, A: FloatArray,
    B: FloatArray, ratio: float, pose: FloatArray,
) -> None:  # fmt: skip
    """Write the pose for which two projected rims, scaled by a ratio, lie on two craters (3,)."""
    X = projection.X
    range2 = np.zeros(2)
    for r in range(3):
        range2[0] += first[r] ** 2
        range2[1] += second[r] ** 2
        pose[POSITION + r] = 0.5 * (first[r] + second[r])
        for c in range(3):
            value = B[0, r] * A[0, c] + B[1, r] * A[1, c] + B[2, r] * A[2, c]
            pose[ROTATION + 3 * r + c] = value
            # Relative to the camera: the altitude is what the ratio scales.
            middle = 0.5 * (X[a, c] + X[b, c]) + projection.range_m * projection.down[c]
            pose[POSITION + r] -= ratio * value * middle
    pose[SPHERE] = 0.5 * (np.sqrt(range2[0]) + np.sqrt(range2[1]))
