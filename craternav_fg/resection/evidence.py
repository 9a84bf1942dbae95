"""Evidence of a consensus: how much more probable the rims are with it than if all matches are wrong.

With it, a rim's chart is normal about that of its crater. Without it, the chart is scattered about the
crater's as widely as the charts of the rims that do not agree. Its centre may also, each as probably, be
anywhere in the image, or where a projective map that is fitted to all matches puts it. So a few rims that
agree prove nothing when all are off in a similar way: by a wrong noise, by another camera, or mirrored.

The ratio of the densities is averaged over all poses by Laplace's approximation. Over images of wrong matches
it has the mean 1, and exceeds L with a probability of at most 1 / L (Markov's inequality).
"""

from math import lgamma

import numpy as np

from craternav_fg.ellipse import half_sides
from craternav_fg.frames import rotation_log
from craternav_fg.resection.problem import ResectionProblem
from factors.arrays import BoolArray, FloatArray
from factors.kernels.validity import UNSEEN

# Standard deviations of size (its logarithm) and of shape (each of two numbers) if nothing is known; they
# count as those of one rim.
_SIZE_SPREAD, _SHAPE_SPREAD = 0.7, 0.3
# Fewest rims to which a linear map, of eight parameters, and a projective one, of eleven, are fitted;
# solutions of linear equations for it, each weighted by the depths of the one before; and the least depth,
# over that of the rims' middle.
_MIN_MAPPED, _MIN_PROJECTED, _MAP_ROUNDS, _MIN_DEPTH = 8, 12, 2, 0.05
# Logarithm of the ratio of the largest to the smallest distance that is possible.
_LOG_RANGES = float(np.log(1e4))
_LOG_2PI = float(np.log(2.0 * np.pi))


def log_evidence(problem: ResectionProblem, gTb: FloatArray, N: FloatArray, members: BoolArray) -> float:
    """Compute the evidence that some of the matches are right, and all others wrong.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        The pose that the right matches give.
    N : ndarray, shape (6, 6)
        Its information, rad and m in b.
    members : ndarray of bool, shape (n,)
        The rims that agree.

    Returns
    -------
    float
        Natural logarithm of the ratio.
    """
    rims = problem.rims
    n, k = len(rims), int(members.sum())
    white = rims.residuals(gTb, problem.bTc)
    seen = np.abs(white).max(axis=1) < UNSEEN
    errors = np.asarray(np.linalg.solve(rims.whitening, white[..., None])[..., 0], dtype=np.float64)
    _, log_det = np.linalg.slogdet(rims.whitening[members])
    agree = -2.5 * _LOG_2PI + log_det - 0.5 * np.sum(white[members] ** 2, axis=1)
    chance = _by_chance(problem, errors, members, ~members & seen)
    choice = lgamma(k + 1.0) + lgamma(n - k + 1.0) - lgamma(n + 2.0)
    first = problem.first_free
    _, log_det_N = np.linalg.slogdet(N[first:, first:])
    volume = 0.5 * (6 - first) * _LOG_2PI - 0.5 * log_det_N
    return float(np.sum(agree - chance) + choice + volume + _log_prior(problem, gTb))


def _by_chance(
    problem: ResectionProblem, errors: FloatArray, members: BoolArray, others: BoolArray
) -> FloatArray:
    """Log densities (k,) of the members' charts if their matches are wrong."""
    rims = problem.rims
    half = half_sides(rims.chart)
    centres = rims.chart[:, :2]
    width, height = (centres + half).max(axis=0) - (centres - half).min(axis=0)
    place = np.sum(errors[:, :2] ** 2, axis=1)
    size = (0.5 * (errors[:, 2] + errors[:, 4])) ** 2
    # The shear has the unit of the ratio of the axes.
    ratio = np.exp(rims.chart[:, 4] - rims.chart[:, 2])
    shape = (errors[:, 4] - errors[:, 2]) ** 2 + (errors[:, 3] / ratio) ** 2
    count = others.sum() + 1.0
    own = rims.covariance[members]
    place2 = (0.5 * place[others].sum() + width * height) / count + 0.5 * (own[:, 0, 0] + own[:, 1, 1])
    size2 = (size[others].sum() + _SIZE_SPREAD**2) / count + 0.25 * (own[:, 2, 2] + own[:, 4, 4])
    shape2 = (0.5 * shape[others].sum() + _SHAPE_SPREAD**2) / count + own[:, 2, 2] + own[:, 4, 4]
    likewise = -_LOG_2PI - np.log(place2) - 0.5 * place[members] / place2
    anywhere = np.full(len(likewise), -np.log(width * height))
    at = np.logaddexp.reduce([likewise, anywhere, _on_projective_map(problem)[members]]) - np.log(3.0)
    of_size = -0.5 * _LOG_2PI - 0.5 * np.log(size2) - 0.5 * size[members] / size2
    of_shape = -_LOG_2PI - np.log(shape2) - 0.5 * shape[members] / shape2 - np.log(ratio[members])
    return np.asarray(at + of_size + of_shape)


def _on_projective_map(problem: ResectionProblem) -> FloatArray:
    """Log densities (n,) of the centres about a projective map of the craters to the image.

    It is fitted to all matches, and -inf with few of them. The map has eleven parameters, those of any camera
    without distortion and of its mirror image. Few rims would fit it whatever they are matched to: theirs is
    linear, with eight.
    """
    rims = problem.rims
    n = len(rims)
    if n < _MIN_MAPPED:
        return np.full(n, -np.inf)
    ground = rims.centres - rims.centres.mean(axis=0)
    columns = np.column_stack([ground / np.abs(ground).max(), np.ones(n)])
    centres = rims.chart[:, :2]
    # Of x = p1 X / p3 X and y = p2 X / p3 X with X = (place, 1), times p3 X; the last of p3 is 1.
    A = np.zeros((2, n, 11))
    A[0, :, :4] = A[1, :, 4:8] = columns
    A[:, :, 8:] = -centres.T[..., None] * columns[:, :3]
    free = 11 if n >= _MIN_PROJECTED else 8
    weight, p = np.ones(n), np.append(np.zeros(11), 1.0)
    for _ in range(_MAP_ROUNDS):
        rows, right = weight[:, None] * A[:, :, :free], weight * centres.T
        p[:free] = np.linalg.lstsq(rows.reshape(-1, free), right.ravel())[0]
        x, y, depth = p.reshape(3, 4) @ columns.T
        # A point that the map puts beside or behind the camera is off by the size of the image or more.
        depth = np.maximum(depth, _MIN_DEPTH)
        weight = 1.0 / depth
    error2 = np.sum((centres.T - np.stack([x, y]) / depth) ** 2, axis=0)
    spread2 = error2.sum() / (2.0 * n - free) + rims.covariance[:, [0, 1], [0, 1]].mean(axis=1)
    return np.asarray(-_LOG_2PI - np.log(spread2) - 0.5 * error2 / spread2)


def _log_prior(problem: ResectionProblem, gTb: FloatArray) -> float:
    """Logarithm of the density of a pose before the image was seen, per rad^3 m^3; per m^3 if it is exact."""
    if problem.prior is not None:
        expected, weight = problem.prior_arrays()
        error = np.append(rotation_log(expected[:3, :3].T @ gTb[:3, :3]), gTb[:3, 3] - expected[:3, 3])
        _, log_det = np.linalg.slogdet(weight)
        return float(-3.0 * _LOG_2PI + 0.5 * log_det - 0.5 * error @ weight @ error)
    place = -np.log(2.0 * np.pi * _LOG_RANGES * problem.range_m(gTb) ** 3)
    if problem.attitude is None:
        return float(place - np.log(8.0 * np.pi**2))
    if problem.first_free:
        return float(place)
    turn = rotation_log(problem.attitude.gRb.T @ gTb[:3, :3]) / problem.attitude.sigma_rad
    return float(place - 1.5 * _LOG_2PI - 3.0 * np.log(problem.attitude.sigma_rad) - 0.5 * turn @ turn)
