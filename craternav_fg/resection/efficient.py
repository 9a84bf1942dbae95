"""The efficient solver: maximum likelihood in the ellipse chart, from no start, with every solution.

Works for one rim or more, with or without a prior, a known attitude, the sun's tilt.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.resection import bounds
from craternav_fg.resection.bounds import MAX_SIGMA
from craternav_fg.resection.caveats import caveats
from craternav_fg.resection.problem import PoseSolution, ResectionProblem, ResectionResult, Status
from craternav_fg.resection.solve_kernel import distance2, invert, minimise, solutions
from factors.kernels.validity import UNSEEN

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Minima whose squared norm exceeds the least by more are less probable than 1e-6: other faults are likelier.
_WINDOW = 30.0
_UNKNOWN_ATTITUDE = np.empty((0, 0))


@dataclass(frozen=True)
class SolveOptions:
    """How poses are searched, and which are believed.

    Attributes
    ----------
    planes : int
        Rims, the best measured first, each of whose two planes gives a start.
    rolls : int
        Starts for each plane of a single rim, over the angle that it leaves free.
    iterations : int
        Linearisations of one minimisation at most.
    least_probability : float
        Less probable solutions are left out, unless they are so far off that they matter all the same.
    raised : float
        What is left out raises no component's mean squared error by more than this part of the most
        probable pose's variance: a tenth leaves its standard deviations true to 5 %.
    misfit_sigma : float
        A squared norm further than this above its expectation contradicts itself.
    noise_allowance : float
        Factor on the squared norm's limit: the errors of the smallest rims' charts have longer tails
        than Gaussian ones.
    """

    planes: int = 2
    rolls: int = 64
    iterations: int = 3000
    least_probability: float = 0.01
    raised: float = 0.1
    misfit_sigma: float = 5.0
    noise_allowance: float = 1.6


def solve(problem: ResectionProblem, options: SolveOptions = SolveOptions()) -> ResectionResult:
    """Pose of an image with its matched rims.

    Parameters
    ----------
    problem : ResectionProblem
        One rim needs a prior, a known attitude or the sun.
    options : SolveOptions

    Returns
    -------
    ResectionResult
        Every pose is a local minimum of the squared norm; its probability is Laplace's, from the norm
        and the information.
    """
    if not len(problem.rims):
        return ResectionResult(Status.TOO_FEW_RIMS, "found no rim, expected one or more", ())
    return _judge(problem, options, *local_minima(problem, options))


def refine(
    problem: ResectionProblem, gTb: FloatArray, options: SolveOptions = SolveOptions()
) -> ResectionResult:
    """Pose of an image from a start: the local minimum that it leads to, whatever others there are.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Where to begin; a known attitude takes the place of its own.
    options : SolveOptions
    """
    if not len(problem.rims):
        return ResectionResult(Status.TOO_FEW_RIMS, "found no rim, expected one or more", ())
    pose = np.array(gTb, dtype=np.float64)
    if problem.attitude is not None:
        pose[:3, :3] = problem.attitude.gRb
    N = np.empty((1, 6, 6))
    prior, weight = bounds.prior_arrays(problem)
    cost, converged = minimise(
        pose, problem.bTc, problem.rims.packed(problem.bTc), prior, weight, bounds.sun_array(problem), 1.0,
        bounds.first_free(problem), options.iterations, N[0],
    )  # fmt: skip
    return _judge(problem, options, pose[None], np.array([cost]), N, np.array([converged]))


def _judge(
    problem: ResectionProblem, options: SolveOptions, gTb: FloatArray, costs: FloatArray, N: FloatArray,
    converged: npt.NDArray[np.bool_],
) -> ResectionResult:  # fmt: skip
    """Make a result of local minima, the cheapest first: which fit, are determined, are probable."""
    # The negated form is also true for NaN.
    if not len(costs) or not costs[0] < UNSEEN**2:
        return ResectionResult(
            Status.NO_POSE, "from nowhere are all rims in front of the camera and seen from above", ()
        )
    if costs[0] > largest_cost(problem, options):
        return ResectionResult(Status.NO_POSE, _misfit(problem, options, gTb[0], costs[0]), ())
    first = bounds.first_free(problem)
    range_m = bounds.range_to(problem, gTb[0])
    covariances, logs = np.empty_like(N), np.empty(len(N))
    for k in range(len(N)):
        logs[k] = invert(N[k], first, covariances[k])
    # A minimum whose information is not positive definite is none; of the best this says what is free.
    variance = covariances[0].diagonal().tolist()
    if not sum(variance[:3]) + sum(variance[3:]) / range_m**2 <= MAX_SIGMA**2:
        seen = bounds.observability(problem, gTb[0], N[0])
        if len(seen.free):
            reason = f"rank {seen.rank}: free are " + "; ".join(seen.words)
            covariances[:] = np.nan
            shares = _shares(-0.5 * (costs - costs[0]))
            return ResectionResult(
                Status.UNDETERMINED, reason, _poses(problem, gTb, covariances, costs, shares)
            )
    # What a minimisation was stopped at, by the edge of the visible or by its iterations, is no minimum.
    minimum = converged & np.isfinite(logs)
    minimum[0] = True
    shares = _shares(np.where(minimum, -0.5 * (costs - costs[0] + logs - logs[0]), -np.inf))
    order = np.argsort(-shares, kind="stable")
    apart2 = np.array([distance2(gTb[order[0]], gTb[k], N[order[0]]) for k in order])
    matters = _that_matter(shares[order], apart2, options)
    order, apart2 = order[matters], apart2[matters]
    shares = shares[order] / shares[order].sum()
    poses = _poses(problem, gTb[order], covariances[order], costs[order], shares)
    if not converged[order[0]]:
        return ResectionResult(
            Status.NOT_CONVERGED, f"no convergence within {options.iterations} linearisations", poses
        )
    if len(poses) > 1:
        text = ", ".join(f"{share:.3g}" for share in shares)
        far = ", ".join(f"{apart:.3g}" for apart in np.sqrt(apart2[1:]))
        reason = f"{len(poses)} poses, of probabilities {text}, {far} standard deviations from the first"
        return ResectionResult(Status.AMBIGUOUS, reason, poses, warnings=caveats(problem, poses))
    return ResectionResult(Status.SOLVED, "", poses, warnings=caveats(problem, poses))


def local_minima(
    problem: ResectionProblem, options: SolveOptions
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Poses, costs, information and convergence of what `solve_kernel.solutions` finds."""
    rims = problem.rims
    prior, weight = bounds.prior_arrays(problem)
    attitude = _UNKNOWN_ATTITUDE if problem.attitude is None else problem.attitude.gRb
    spread = rims.covariance[:, 2, 2] + rims.covariance[:, 4, 4]
    reference = np.argsort(spread)[: options.planes]
    return solutions(
        problem.bTc, rims.centres, rims.axes, rims.chart, rims.whitening, prior, weight,
        bounds.sun_array(problem), attitude, bounds.first_free(problem), reference, options.rolls,
        options.iterations, _WINDOW,
    )  # fmt: skip


def largest_cost(problem: ResectionProblem, options: SolveOptions) -> float:
    """Squared norm above which rims (and prior, and sun) contradict each other."""
    first = bounds.first_free(problem)
    rows = 5 * len(problem.rims) + (problem.sun is not None) + 6 * (problem.prior is not None)
    rows += 3 * (problem.attitude is not None and first == 0)
    freedom = max(rows - (6 - first), 1)
    # Wilson and Hilferty's approximation of the chi-square quantile.
    share = 2.0 / (9.0 * freedom)
    return float(
        options.noise_allowance * freedom * (1.0 - share + options.misfit_sigma * np.sqrt(share)) ** 3
    )


def _misfit(problem: ResectionProblem, options: SolveOptions, gTb: FloatArray, cost: float) -> str:
    """Say how badly the best pose fits, and what is to blame: what is known beside the rims, or a rim.

    Shares of the squared norm don't tell: the weaker source gives way to the stronger wrong one. What all
    others agree without is at fault.
    """
    beside = {"prior": problem.prior, "attitude": problem.attitude, "sun": problem.sun}
    known = [name for name, value in beside.items() if value is not None]
    text = f"the best pose leaves a squared norm of {cost:.3g}"
    if known and len(problem.rims) == 1:
        what = " or the ".join(known)
        return f"{text}: the match of crater {problem.rims.identifiers[0]!r} or the {what} is wrong"
    culprits = []
    for name in known:
        others = replace(problem, **{name: None})  # type: ignore[arg-type]
        _, costs, _, _ = local_minima(others, options)
        if len(costs) and costs[0] <= largest_cost(others, options):
            culprits.append(name)
    if culprits:
        match = ", or a match is wrong" if len(problem.rims) == 2 else ""
        return f"{text}: the {' or the '.join(culprits)} contradicts the rest, which agrees without it{match}"
    each = np.sum(problem.rims.residuals(gTb, problem.bTc) ** 2, axis=1)
    k = int(np.argmax(each))
    return (
        f"{text}, the most by a single rim ({each[k]:.3g}) at crater {problem.rims.identifiers[k]!r}: "
        "a wrong match, or another camera"
    )


def _shares(logs: FloatArray) -> FloatArray:
    """Probabilities of minima whose unnormalised logarithms are given."""
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def _that_matter(shares: FloatArray, apart2: FloatArray, options: SolveOptions) -> npt.NDArray[np.bool_]:
    """Mask of the solutions to be told of; `apart2` are squared Mahalanobis distances from the first."""
    matters = shares >= options.least_probability
    # No component is off by more of its variance than the squared distance says.
    effect = shares * apart2
    rank = np.argsort(effect)
    matters[rank[np.cumsum(effect[rank]) > options.raised]] = True
    matters[0] = True
    return np.asarray(matters)


def _poses(
    problem: ResectionProblem, gTb: FloatArray, covariances: FloatArray, costs: FloatArray,
    shares: FloatArray,
) -> tuple[PoseSolution, ...]:  # fmt: skip
    return tuple(
        PoseSolution(T, covariance, problem.rims.residuals(T, problem.bTc), float(cost), float(share))
        for T, covariance, cost, share in zip(gTb, covariances, costs, shares, strict=True)
    )
