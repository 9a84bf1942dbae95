"""Brightness of the ground at each point of a rim, as the flanks of the rim crest show it.

Patches of other albedo and the ground's own slopes make one part of a rim brighter than another, and a
crossing of one reference brightness (see `edges`) then lies beside the crest. But they change the inner wall
and the outer slope alike. The crest is as bright as level ground, so it lies at the same share of the step
from the outer slope to the inner wall all around the rim. That share follows from the rim as a whole; with it
the two flanks of each normal give the level there.

The flanks show neighbouring craters and fine relief, too, which the crossing of the reference does not see.
So the level counts as much as it explains: where it is right, the points that cross the reference lie beside
an ellipse by what the level says. The regression of one on the other is done for each rim, with the share
that all rims of the frame have in common as its prior.

Where the ground is much darker than the reference, the outer slope may be brighter than the reference or the
inner wall darker: the crossing is lost, or found far from the crest, and always on the same side of it. On
patches of other albedo rims would get too small. So where the reference is not crossed, the flanks alone tell
the edge; and a first ellipse shows where the flanks are, all around the rim, and the edge is searched once
more where the brightness crosses the level, smooth along the rim, that they show. A slope of the level along
the illumination direction cannot be told from flanks that are steeper on one side: it is left out, and
remains as an error of the size.
"""

import numpy as np

from craternav_fg.vision.robust_scale import MAD_TO_SIGMA
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Limits of the crest's share of the step: beyond, the flanks are not those of a crest.
_LEAST_SHARE, _LARGEST_SHARE = 0.1, 0.9
# Steepness over the canonical crater's that counts: what looks steeper is the image's tone, not the ground.
_MOST_STEEPNESS = 1.5
# Harmonics of an ellipse's displacement: what else the points show is not the ellipse's.
_ELLIPSE_TERMS = 5
# Prior of the share of the level that all rims of a frame have in common, and its weight; weight of the
# common share in each rim's. Weights are sums of squared displacements over points, with the square of the
# slope contrast as the weight of each, px^2.
_PRIOR_SHARE, _PRIOR_PX2, _COMMON_PX2 = 0.6, 1.0, 4.0
# The regression sees the harmonics that an ellipse has not. In those that it has, the level, which is smooth,
# stands out more from the relief beside the crest: ratio of its signal to noise there over that in the
# regression. Chosen on ground of another renderer.
_SMOOTH_GAIN = 2.5
# Harmonics of the smooth level: a constant and two orders. Iterations of its robust fit, and its scale in
# standard deviations.
LEVEL_TERMS = 5
_LEVEL_ITERATIONS, _LEVEL_SCALE_SIGMAS = 6, 2.0
# Least brightness of level ground, over the reference.
_DARKEST = 0.4


@njit(cache=True, error_model="numpy")
def steepness_of_flanks(
    flanks: FloatArray, contrasts: FloatArray, slopes: FloatArray, bends: FloatArray
) -> float:
    """Compare how steep the flanks look with those of the canonical crater.

    Parameters
    ----------
    flanks, contrasts, slopes, bends : ndarray, shapes (n, 2), (n,), (n, 2), (n, 2)
        See `levels_of_flanks`.

    Returns
    -------
    float
        Ratio of the steps between the flanks; not below 0. The photometric law and the tone of the image
        may have a part in it.
    """
    found, canonical = 0.0, 0.0
    for i in range(len(contrasts)):
        c = contrasts[i]
        found += c * (flanks[i, 0] - flanks[i, 1])
        canonical += c * (c * (slopes[i, 0] - slopes[i, 1]) + bends[i, 0] - bends[i, 1])
    return max(found / canonical, 0.0) if canonical > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def levels_of_flanks(
    flanks: FloatArray, contrasts: FloatArray, slopes: FloatArray, bends: FloatArray
) -> FloatArray:
    """Compute the brightness of level ground at points of one rim.

    Parameters
    ----------
    flanks : ndarray, shape (n, 2)
        Brightness of the inner wall and of the outer slope relative to the reference, less 1.
    contrasts : ndarray, shape (n,)
        Slope contrast across the rim, with sign.
    slopes, bends : ndarray, shape (n, 2)
        What the canonical crater's flanks show, see `crest_tables.flank_terms`.

    Returns
    -------
    ndarray, shape (n,)
        Relative to the reference, less 1.
    """
    steepness = min(steepness_of_flanks(flanks, contrasts, slopes, bends), _MOST_STEEPNESS)
    # What is not in proportion to the contrast is of the second order of the slope or more. Of the rest, the
    # slopes are what changes sign with the contrast.
    square = steepness * steepness
    inner, outer, weight = 0.0, 0.0, 0.0
    for i in range(len(contrasts)):
        inner += contrasts[i] * (flanks[i, 0] - square * bends[i, 0])
        outer += contrasts[i] * (flanks[i, 1] - square * bends[i, 1])
        weight += contrasts[i] * contrasts[i]
    inner, outer = inner / weight, outer / weight
    share = 0.5 if inner == outer else -outer / (inner - outer)
    share = min(max(share, _LEAST_SHARE), _LARGEST_SHARE)
    out = np.empty(len(contrasts))
    for i in range(len(contrasts)):
        low = flanks[i, 1] - square * bends[i, 1]
        out[i] = low + share * (flanks[i, 0] - square * bends[i, 0] - low)
    return out


@njit(cache=True, error_model="numpy")
def level_at(harmonics: FloatArray, angle: float) -> float:
    """Compute a smooth level at a point of the rim.

    Parameters
    ----------
    harmonics : ndarray, shape (5,)
        See `smooth_level`.
    angle : float
        Affine angle of the point, rad.

    Returns
    -------
    float
        Relative to the reference, less 1; not so dark that nothing could be seen.
    """
    c, s = np.cos(angle), np.sin(angle)
    value = harmonics[0] + harmonics[1] * c + harmonics[2] * s
    value += harmonics[3] * (c * c - s * s) + harmonics[4] * 2.0 * s * c
    return max(value, _DARKEST - 1.0)


@njit(cache=True, error_model="numpy")
def smooth_level(
    angles: FloatArray, flanks: FloatArray, contrasts: FloatArray, slopes: FloatArray, bends: FloatArray
) -> FloatArray:
    """Fit a smooth function of the angle to the brightness of level ground around one rim.

    Parameters
    ----------
    angles : ndarray, shape (n,)
        Affine angles of points along the rim, rad.
    flanks, contrasts, slopes, bends : ndarray, shapes (n, 2), (n,), (n, 2), (n, 2)
        See `levels_of_flanks`.

    Returns
    -------
    ndarray, shape (5,)
        Constant, cosine and sine, and those of twice the angle; zero with too few points.
    """
    count = len(angles)
    if count <= 2 * LEVEL_TERMS:
        return np.zeros(LEVEL_TERMS)
    level = levels_of_flanks(flanks, contrasts, slopes, bends)
    A = np.empty((count, LEVEL_TERMS))
    for i in range(count):
        c, s = np.cos(angles[i]), np.sin(angles[i])
        A[i, 0], A[i, 1], A[i, 2], A[i, 3], A[i, 4] = 1.0, c, s, c * c - s * s, 2.0 * s * c
    weight = np.ones(count)
    out = np.zeros(LEVEL_TERMS)
    for _ in range(_LEVEL_ITERATIONS):
        N, y = np.zeros((LEVEL_TERMS, LEVEL_TERMS)), np.zeros(LEVEL_TERMS)
        for i in range(count):
            for a in range(LEVEL_TERMS):
                y[a] += weight[i] * A[i, a] * level[i]
                for b in range(LEVEL_TERMS):
                    N[a, b] += weight[i] * A[i, a] * A[i, b]
        for a in range(LEVEL_TERMS):
            N[a, a] *= 1.0 + 1e-9
        out[:] = np.linalg.solve(N, y)
        off = level - A @ out
        scale = _LEVEL_SCALE_SIGMAS * MAD_TO_SIGMA * np.median(np.abs(off)) + 1e-9
        for i in range(count):
            weight[i] = 1.0 / (1.0 + (off[i] / scale) ** 2)
    return out


@njit(cache=True, error_model="numpy")
def evidence_of_level(
    angles: FloatArray, weights: FloatArray, crossings_px: FloatArray, shifts_px: FloatArray
) -> FloatArray:
    """Compare where points lie with where the level of the ground says that they should.

    Parameters
    ----------
    angles : ndarray, shape (n,)
        Affine angles of the points along the rim, rad.
    weights : ndarray, shape (n,)
        Reciprocals of their relative standard deviations.
    crossings_px : ndarray, shape (n,)
        Displacements along the normal of the crossings of the reference brightness.
    shifts_px : ndarray, shape (n,)
        From there to the crossing of the level.

    Returns
    -------
    ndarray, shape (2,)
        Numerator and denominator of the regression: sums over points, px^2, of what is no ellipse's.
    """
    A = np.empty((len(angles), _ELLIPSE_TERMS))
    y = np.empty((len(angles), 2))
    for i in range(len(angles)):
        w = weights[i]
        A[i, 0] = w
        A[i, 1], A[i, 2] = w * np.cos(angles[i]), w * np.sin(angles[i])
        A[i, 3], A[i, 4] = w * np.cos(2.0 * angles[i]), w * np.sin(2.0 * angles[i])
        y[i, 0], y[i, 1] = w * crossings_px[i], w * shifts_px[i]
    out = np.zeros(2)
    if len(angles) <= _ELLIPSE_TERMS:
        return out
    N = A.T @ A
    for j in range(_ELLIPSE_TERMS):
        N[j, j] *= 1.0 + 1e-9
    y -= A @ np.linalg.solve(N, A.T @ y)
    for i in range(len(angles)):
        out[0] -= y[i, 0] * y[i, 1]
        out[1] += y[i, 1] * y[i, 1]
    return out


def common_share(evidence: FloatArray) -> float:
    """Compute the share with which the level of the ground counts in a frame.

    Parameters
    ----------
    evidence : ndarray, shape (n, 2)
        See `evidence_of_level`, by rim.

    Returns
    -------
    float
        0 to 1; the prior without rims.
    """
    explained, whole = np.sum(evidence, axis=0) + _PRIOR_PX2 * np.array([_PRIOR_SHARE, 1.0])
    return float(np.clip(explained / whole, 0.0, 1.0))


def own_share(evidence: FloatArray, common: float) -> float:
    """Compute the share with which the level of the ground counts at one rim.

    Parameters
    ----------
    evidence : ndarray, shape (2,)
        See `evidence_of_level`.
    common : float
        See `common_share`.

    Returns
    -------
    float
        0 to 1.
    """
    share = (evidence[0] + _COMMON_PX2 * common) / (evidence[1] + _COMMON_PX2)
    return float(np.clip(share, 0.0, 1.0))


def smooth_share(share: float) -> float:
    """Compute the share with which the level of the ground counts in what an ellipse follows.

    Parameters
    ----------
    share : float
        That of the higher harmonics, see `own_share`.

    Returns
    -------
    float
        0 to 1, not below `share`.
    """
    return _SMOOTH_GAIN * share / (1.0 + (_SMOOTH_GAIN - 1.0) * share)
