"""Robust resection: rims that are matched to the wrong crater are found, named and left out."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.resection.bounds import information
from craternav_fg.resection.efficient import SolveOptions, solve
from craternav_fg.resection.problem import PoseSolution, ResectionProblem, ResectionResult, Status
from craternav_fg.resection.robust_kernel import consensus, distances2

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

# Rounds in which a rim that was left out may come back.
_ROUNDS = 5


@dataclass(frozen=True)
class RobustOptions:
    """When a rim counts as wrongly matched.

    Attributes
    ----------
    gate : float
        Squared Mahalanobis distance, five degrees of freedom, above which a rim does not agree with a pose.
    least_rims : int
        Number of rims that must agree; one less with a prior, the sun or a known attitude. Fewer rims agree
        on some pose whatever they are matched to. With a known attitude a single rim is taken as it is.
    minimal_sets : int
        Largest number of minimal sets that are tried, those with the best measured rims first: pairs of rims,
        or single rims with a known attitude.
    solve : SolveOptions
        Of the solution from the rims that agree.
    """

    gate: float = 30.0
    least_rims: int = 3
    minimal_sets: int = 200
    solve: SolveOptions = field(default_factory=SolveOptions)


def solve_robustly(problem: ResectionProblem, options: RobustOptions = RobustOptions()) -> ResectionResult:
    """Estimate the pose of an image some of whose rims may be matched to the wrong crater.

    Parameters
    ----------
    problem : ResectionProblem
    options : RobustOptions

    Returns
    -------
    ResectionResult
        Its `wrong` names the craters of the rims that were left out; its residuals are of all rims.
    """
    least = _least(problem, options)
    rims = problem.rims
    if len(rims) < least:
        return ResectionResult(
            Status.TOO_FEW_RIMS, f"found {len(rims)} rims, expected {least} or more to check each other", ()
        )
    prior, weight = problem.prior_arrays()
    attitude = np.empty((0, 0)) if problem.attitude is None else problem.attitude.gRb
    members, _ = consensus(
        problem.bTc, rims.centres, rims.axes, rims.chart, rims.whitening, prior, weight,
        problem.sun_array(), attitude, problem.first_free, _seeds(problem, options), options.gate,
    )  # fmt: skip
    result, kept = _solve_consistently(problem, members, least, options)
    wrong = tuple(name for name, agrees in zip(rims.identifiers, kept, strict=True) if not agrees)
    poses = tuple(_of_all(problem, pose) for pose in result.poses)
    return replace(result, poses=poses, wrong=wrong if poses else ())


def _least(problem: ResectionProblem, options: RobustOptions) -> int:
    """Give the number of rims that must agree."""
    if problem.attitude is not None:
        # One of several rims that agrees with none of the others proves nothing.
        return 1 if len(problem.rims) == 1 else max(options.least_rims - 1, 2)
    return max(options.least_rims - (problem.prior is not None or problem.sun is not None), 1)


def _solve_consistently(
    problem: ResectionProblem, members: BoolArray, least: int, options: RobustOptions
) -> tuple[ResectionResult, BoolArray]:
    """Solve from the rims that agree until they are those that agree with the solution."""
    rims = problem.rims
    for turn in itertools.count():
        if members.sum() < least:
            reason = f"no {least} of the {len(rims)} rims agree on a pose within the gate"
            return ResectionResult(Status.NO_POSE, reason, ()), members
        part = replace(problem, rims=rims.take(members))
        result = solve(part, options.solve)
        if not result.poses or result.status is Status.UNDETERMINED:
            break
        gTb = result.poses[0].gTb
        d2 = distances2(gTb, information(part, gTb), problem.first_free, members, rims.packed(problem.bTc))
        agree = d2 < options.gate
        # A rim near the gate could come and go for ever.
        if turn >= _ROUNDS:
            agree &= members
        if (agree == members).all():
            break
        members = agree
    return result, members


def _of_all(problem: ResectionProblem, pose: PoseSolution) -> PoseSolution:
    """Pose with the residuals of all rims."""
    return replace(pose, residuals=problem.rims.residuals(pose.gTb, problem.bTc))


def _seeds(problem: ResectionProblem, options: RobustOptions) -> IntArray:
    """Minimal sets (m, 2) of rims, those with the best measured first."""
    rims = problem.rims
    order = np.argsort(rims.covariance[:, 2, 2] + rims.covariance[:, 4, 4])
    n = len(order)
    if problem.attitude is not None or n == 1:
        return np.stack([order, order], axis=-1)[: options.minimal_sets]
    i, j = np.nonzero(~np.eye(n, dtype=bool))
    first = np.argsort(i + j, kind="stable")[: options.minimal_sets]
    return np.stack([order[i[first]], order[j[first]]], axis=-1)
