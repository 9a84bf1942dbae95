"""Robust resection: wrong matches are found, named and left out; too small sigmas are enlarged."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from craternav_fg.resection.bounds import information
from craternav_fg.resection.caveats import inflation_warning
from craternav_fg.resection.efficient import SolveOptions, solve
from craternav_fg.resection.evidence import log_evidence
from craternav_fg.resection.problem import PoseSolution, ResectionProblem, ResectionResult, Status
from craternav_fg.resection.robust_kernel import consensus, distances2
from factors.arrays import BoolArray, IntArray

# Fewest rims whose residuals show that their standard deviations are too small.
_SCALED_RIMS = 5
# Standard deviations above the expected cost, up to which the rims' own standard deviations are believed.
_COST_SIGMAS = 4.0
# Rounds in which a rim that was left out may come back.
_ROUNDS = 5


@dataclass(frozen=True)
class RobustOptions:
    """When a rim counts as wrongly matched, and when rims that agree are believed.

    Attributes
    ----------
    gate_chi2 : float
        Squared Mahalanobis distance, five degrees of freedom, above which a rim does not agree with a pose.
    least_rims : int
        Number of rims that must agree; one less with a prior, the sun or a known attitude. Fewer rims agree
        on some pose whatever they are matched to. With a known attitude a single rim is taken as it is.
    minimal_sets : int
        Largest number of minimal sets that are tried: pairs of rims, or single rims with a known attitude.
        The first half are those with the best measured rims, the others are spread over the rest.
    log_chance : float
        Natural logarithm of the largest probability that rims which agree do so by chance.
    sigma_scales : tuple of float
        Factors on the standard deviations of the rims that are tried. The first is used when it makes more
        than half of the rims agree, else the one with the most evidence.
    solve : SolveOptions
        Options of the solution from the rims that agree.
    """

    gate_chi2: float = 30.0
    least_rims: int = 3
    minimal_sets: int = 200
    log_chance: float = float(np.log(1e-6))
    sigma_scales: tuple[float, ...] = (1.0, 3.0, 10.0)
    solve: SolveOptions = field(default_factory=SolveOptions)


@dataclass(frozen=True)
class _Consensus:
    """Rims that agree, the pose they give, and the logarithm of the evidence for it."""

    result: ResectionResult
    members: BoolArray
    log_evidence: float


def solve_robustly(problem: ResectionProblem, options: RobustOptions = RobustOptions()) -> ResectionResult:
    """Estimate the pose of an image some of whose rims may be matched to the wrong crater.

    Parameters
    ----------
    problem : ResectionProblem
    options : RobustOptions

    Returns
    -------
    ResectionResult
        Its `wrong` names the craters of the rims that were left out; its residuals are of all rims. Rims that
        agree no better than chance would have it are `NO_POSE`.
    """
    least = _least(problem, options)
    n = len(problem.rims)
    if n < least:
        return ResectionResult(
            Status.TOO_FEW_RIMS, f"found {n} rims, expected {least} or more to check each other", ()
        )
    best: _Consensus | None = None
    for scale in options.sigma_scales:
        found = _consensus(problem.inflated(scale), least, options)
        if best is None or found.log_evidence > best.log_evidence:
            best = _scaled_to_residuals(problem, found, scale, least, options)
        if scale == options.sigma_scales[0] and _majority_agrees(found, options):
            break
    assert best is not None
    result, left_out = best.result, int(np.sum(~best.members))
    if not result.poses:
        return result
    if best.log_evidence < -options.log_chance:
        agree = f"{n - left_out} of {n} rims agree on a pose, which wrong matches do by chance as well"
        return ResectionResult(Status.NO_POSE, agree, ())
    warnings = list(result.warnings)
    if 2 * left_out > n:
        warnings.insert(0, f"{left_out} of {n} rims were left out as wrongly matched")
    if result.sigma_scale > 1.0:
        warnings.append(inflation_warning(result.sigma_scale))
    names = problem.rims.identifiers
    return replace(
        result,
        poses=tuple(_of_all(problem.inflated(result.sigma_scale), pose) for pose in result.poses),
        wrong=tuple(name for name, agrees in zip(names, best.members, strict=True) if not agrees),
        warnings=tuple(warnings),
    )


def solve_all(problem: ResectionProblem) -> ResectionResult:
    """Estimate the pose of an image all of whose rims are rightly matched, with too small sigmas perhaps.

    Parameters
    ----------
    problem : ResectionProblem

    Returns
    -------
    ResectionResult
        As `solve` gives it. When the rims contradict each other, but no subset of them is more credible than
        all of them with larger standard deviations, those are used; see `ResectionResult.sigma_scale`.
    """
    result = solve(problem)
    if result.status is not Status.NO_POSE or len(problem.rims) < _SCALED_RIMS:
        return result
    scaled = solve_robustly(problem)
    return scaled if scaled.sigma_scale > 1.0 and not scaled.wrong else result


def _majority_agrees(found: _Consensus, options: RobustOptions) -> bool:
    """Whether more than half of the rims agree as closely as expected, or there is no evidence to compare."""
    if found.log_evidence == np.inf:
        return True
    agree = int(found.members.sum())
    if found.log_evidence < -options.log_chance or 2 * agree <= len(found.members):
        return False
    freedom = max(5 * agree - 6, 1)
    return bool(found.result.poses[0].cost < freedom + _COST_SIGMAS * np.sqrt(2.0 * freedom))


def _consensus(problem: ResectionProblem, least: int, options: RobustOptions) -> _Consensus:
    """Find the rims that agree on one pose, and solve from them."""
    rims = problem.rims
    prior, weight = problem.prior_arrays()
    attitude = np.empty((0, 0)) if problem.attitude is None else problem.attitude.gRb
    members, _ = consensus(
        problem.bTc, rims.centres, rims.axes, rims.chart, rims.whitening, prior, weight,
        problem.sun_array(), attitude, problem.first_free, _seeds(problem, options), options.gate_chi2,
    )  # fmt: skip
    return _with_evidence(problem, *_solve_consistently(problem, members, least, options))


def _with_evidence(problem: ResectionProblem, result: ResectionResult, members: BoolArray) -> _Consensus:
    """Compute the evidence of a solution; a single rim and an undetermined pose have none to be judged by."""
    if not result.poses:
        return _Consensus(result, members, -np.inf)
    if len(problem.rims) == 1 or result.status is Status.UNDETERMINED:
        return _Consensus(result, members, np.inf)
    gTb = result.poses[0].gTb
    N = information(replace(problem, rims=problem.rims.take(members)), gTb)
    return _Consensus(result, members, log_evidence(problem, gTb, N, members))


def _scaled_to_residuals(
    problem: ResectionProblem, found: _Consensus, scale: float, least: int, options: RobustOptions
) -> _Consensus:
    """Solve again with the scale of the standard deviations that the residuals have, at least 1."""
    if scale == 1.0 or not found.result.poses:
        return found
    freedom = max(5 * int(found.members.sum()) - 6, 1)
    scale = max(scale * float(np.sqrt(found.result.poses[0].cost / freedom)), 1.0)
    scaled = problem.inflated(scale)
    result, members = _solve_consistently(scaled, found.members, least, options)
    return _with_evidence(scaled, replace(result, sigma_scale=scale), members)


def _least(problem: ResectionProblem, options: RobustOptions) -> int:
    """Return the number of rims that must agree."""
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
        agree = d2 < options.gate_chi2
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
    """Minimal sets (m, 2) of rims: those with the best measured, and, lest these are wrong, some of all."""
    rims = problem.rims
    order = np.argsort(rims.covariance[:, 2, 2] + rims.covariance[:, 4, 4])
    n = len(order)
    if problem.attitude is not None or n == 1:
        return np.stack([order, order], axis=-1)[_spread(n, options.minimal_sets)]
    i, j = np.nonzero(~np.eye(n, dtype=bool))
    tried = np.argsort(i + j, kind="stable")[_spread(len(i), options.minimal_sets)]
    return np.stack([order[i[tried]], order[j[tried]]], axis=-1)


def _spread(count: int, most: int) -> IntArray:
    """Choose at most so many of a ranked list: the first ones, and as many spread evenly over the others."""
    if count <= most:
        return np.arange(count)
    first = most - most // 2
    return np.append(np.arange(first), np.linspace(first, count - 1, most // 2).astype(np.int64))
