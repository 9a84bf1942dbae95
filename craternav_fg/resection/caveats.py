"""What to know before a pose is believed, beside its status."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.resection import bounds
from craternav_fg.resection.problem import PoseSolution, ResectionProblem
from craternav_fg.resection.solve_kernel import normal_equations
from factors.kernels.gauss_newton import screw
from factors.kernels.packed import CRATER, HEADER

FloatArray = npt.NDArray[np.float64]

# Of the squared norm from its parabola: half of the 1 by which a standard deviation is defined.
_LARGEST_DEPARTURE = 0.5
_STEPS = np.array([-2.0, -1.0, 1.0, 2.0])
_POWERS = 20


def caveats(problem: ResectionProblem, poses: Sequence[PoseSolution]) -> tuple[str, ...]:
    """Say what is weak about the poses of a problem, one line each.

    Parameters
    ----------
    problem : ResectionProblem
    poses : sequence of PoseSolution
        With their covariances.
    """
    out = []
    count = len(problem.rims)
    enough = 3 if problem.attitude is None else 2
    if count < enough:
        which = "1 rim checks its match" if count == 1 else f"{count} rims check their matches"
        out.append(f"{which} hardly: a wrong one can pass unnoticed, {enough} rims would show it")
    if any(departure(problem, pose) > _LARGEST_DEPARTURE for pose in poses):
        out.append(
            "the covariance may not describe the errors: within two standard deviations along the weakest "
            "direction the squared norm is no parabola"
        )
    return tuple(out)


def departure(problem: ResectionProblem, pose: PoseSolution) -> float:
    """Largest difference of the squared norm from its parabola, one and two weakest sigmas away."""
    prior, weight = bounds.prior_arrays(problem)
    return _departure(
        np.ascontiguousarray(pose.gTb), problem.bTc, problem.rims.packed(problem.bTc), prior, weight,
        bounds.sun_array(problem), np.ascontiguousarray(pose.covariance), bounds.range_to(problem, pose.gTb),
        pose.cost, _STEPS,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _departure(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, covariance: FloatArray, range_m: float, cost: float, steps: FloatArray,
) -> float:  # fmt: skip
    """Evaluate `departure`; the weakest direction, by parts of the range, comes by power iteration."""
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
