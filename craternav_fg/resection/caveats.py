"""Warnings about solutions that are formally valid."""

from collections.abc import Sequence

import numpy as np

from craternav_fg import frames
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.problem import PoseSolution, ResectionProblem
from craternav_fg.resection.solve_kernel import normal_equations
from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import screw
from factors.kernels.packed import CRATER, HEADER

# Fewest rims that show a wrong match: with fewer, some pose explains the wrong match as well.
_CHECKED_RIMS, _CHECKED_RIMS_WITH_ATTITUDE = 3, 2
# Largest difference of the cost from its parabola: half of the 1 that defines a standard deviation.
_MAX_DEPARTURE = 0.5
# Where the cost is compared with the parabola, in standard deviations along the weakest direction.
_STEPS = np.array([-2.0, -1.0, 1.0, 2.0])
# Squared rotation from a known attitude, in its standard deviations, that a right one exceeds once in ten
# million cases: the quantile of chi-square. To compute it, scipy has to be imported, which takes long.
_MOST_TURN = 35.4058
# Power iterations for the weakest direction.
_POWERS = 20


def caveats(problem: ResectionProblem, poses: Sequence[PoseSolution]) -> tuple[str, ...]:
    """Warn about weaknesses of the poses of a problem.

    Parameters
    ----------
    problem : ResectionProblem
    poses : sequence of PoseSolution
        With their covariances.

    Returns
    -------
    tuple of str
        One line each.
    """
    out = []
    count = len(problem.rims)
    enough = _CHECKED_RIMS if problem.attitude is None else _CHECKED_RIMS_WITH_ATTITUDE
    if count < enough:
        rims = "1 rim" if count == 1 else f"{count} rims"
        out.append(f"{rims} cannot reveal a wrong match: {enough} or more rims would check each other")
    if any(departure(problem, pose) > _MAX_DEPARTURE for pose in poses):
        out.append(
            "the covariance may not describe the errors: the cost is not quadratic within two standard "
            "deviations along the weakest direction"
        )
    if problem.attitude is not None and poses:
        out.extend(attitude_warnings(problem.attitude, poses[0].gTb[:3, :3]))
    return tuple(out)


def attitude_warnings(known: KnownAttitude, gRb: FloatArray) -> tuple[str, ...]:
    """Warn if the rims turn the pose far from the known attitude.

    Parameters
    ----------
    known : KnownAttitude
    gRb : ndarray, shape (3, 3)
        Of the pose that rims and known attitude determine.

    Returns
    -------
    tuple of str
        At most one line.
    """
    turn = float(np.linalg.norm(frames.rotation_log(known.gRb.T @ gRb)))
    # Rims cannot turn a pose from an exact attitude.
    if known.sigma_rad == 0.0 or turn**2 <= _MOST_TURN * known.sigma_rad**2:
        return ()
    found, stated = np.degrees((turn, known.sigma_rad))
    return (
        f"the rims contradict the attitude: the pose is turned by {found:.2g} deg from it, with a standard "
        f"deviation of {stated:.2g} deg; check --attitude (gRb as w,x,y,z) and the mounting T_BS",
    )


def inflation_warning(scale: float) -> str:
    """Say by which factor the standard deviations of the rims are too small."""
    return (
        f"the rims scatter {scale:.2g} times as widely as their standard deviations say: the covariance is "
        "computed with larger ones"
    )


def departure(problem: ResectionProblem, pose: PoseSolution) -> float:
    """Compute the largest difference of the cost from its parabola along the weakest direction.

    Parameters
    ----------
    problem : ResectionProblem
    pose : PoseSolution
        With its covariance.

    Returns
    -------
    float
        One or two standard deviations away.
    """
    prior, weight = problem.prior_arrays()
    return _departure(
        np.ascontiguousarray(pose.gTb), problem.bTc, problem.rims.packed(problem.bTc), prior, weight,
        problem.sun_array(), np.ascontiguousarray(pose.covariance), problem.range_m(pose.gTb), pose.cost,
        _STEPS,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _departure(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, covariance: FloatArray, range_m: float, cost: float, steps: FloatArray,
) -> float:  # fmt: skip
    """Evaluate `departure`; the weakest direction, with translations over the range, by power iteration."""
    v, w = np.ones(6), np.empty(6)
    scale = np.ones(6)
    for i in range(3, 6):
        scale[i] = range_m
    variance = 0.0
    for _ in range(_POWERS):
        norm = 0.0
        for i in range(6):
            w[i] = 0.0
            for j in range(6):
                w[i] += covariance[i, j] / (scale[i] * scale[j]) * v[j]
            norm += w[i] * w[i]
        variance = np.sqrt(norm)
        for i in range(6):
            v[i] = w[i] / variance
    rows = np.empty((7, 5 * ((data.shape[0] - HEADER) // CRATER)))
    N, g, twist, moved = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((4, 4))
    largest = 0.0
    for step in steps:
        for i in range(6):
            twist[i] = step * np.sqrt(variance) * v[i] * scale[i]
        for i in range(4):
            for j in range(4):
                moved[i, j] = gTb[i, j]
        screw(moved, twist)
        found = normal_equations(moved, bTc, data, prior, prior_weight, sun, 1.0, rows, N, g)
        largest = max(largest, abs(found - cost - step * step))
    return largest
