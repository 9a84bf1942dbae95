"""What to know before a pose is believed, beside its status."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from craternav_fg.static import bounds
from craternav_fg.static.problem import StaticPose, StaticProblem
from craternav_fg.static.solve_kernel import normal_equations
from factors.kernels.gauss_newton import screw

FloatArray = npt.NDArray[np.float64]

# Of the squared norm from its parabola: half of the 1 by which a standard deviation is defined.
_LARGEST_DEPARTURE = 0.5
_STEPS = (-2.0, -1.0, 1.0, 2.0)


def caveats(problem: StaticProblem, poses: Sequence[StaticPose]) -> tuple[str, ...]:
    """Say what is weak about the poses of a problem, one line each.

    Parameters
    ----------
    problem : StaticProblem
    poses : sequence of StaticPose
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


def departure(problem: StaticProblem, pose: StaticPose) -> float:
    """Largest difference of the squared norm from its parabola, one and two weakest sigmas away."""
    first = bounds.first_free(problem)
    range_m = bounds.range_to(problem, pose.gTb)
    scale = np.array([1.0, 1.0, 1.0, range_m, range_m, range_m])[first:]
    values, vectors = np.linalg.eigh(pose.covariance[first:, first:] / np.outer(scale, scale))
    sigma = np.zeros(6)
    sigma[first:] = np.sqrt(values[-1]) * vectors[:, -1] * scale
    data = problem.rims.packed(problem.bTc)
    prior, weight = bounds.prior_arrays(problem)
    sun = bounds.sun_array(problem)
    rows, N, g = np.empty((7, 5 * len(problem.rims))), np.empty((6, 6)), np.empty(6)
    largest = 0.0
    for step in _STEPS:
        gTb = pose.gTb.copy()
        screw(gTb, step * sigma)
        cost = normal_equations(gTb, problem.bTc, data, prior, weight, sun, 1.0, rows, N, g)
        largest = max(largest, abs(cost - pose.cost - step * step))
    return largest
