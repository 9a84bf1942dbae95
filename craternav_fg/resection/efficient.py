"""Maximum-likelihood resection, a statistically efficient estimate: from no start, with every solution.

Works for one rim or more; a prior, a known attitude and the sun's tilt are used when given.
"""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.resection.bounds import MAX_SIGMA, observability
from craternav_fg.resection.caveats import caveats
from craternav_fg.resection.problem import PoseSolution, ResectionProblem, ResectionResult, Status
from craternav_fg.resection.solve_kernel import (
    covariance_and_log_det,
    minimise,
    solutions,
    squared_distance,
)
from factors.arrays import BoolArray, FloatArray
from factors.kernels.validity import UNSEEN

# Minima whose cost exceeds the least by more are not pursued: they are less likely by exp(-15) = 3e-7.
_COST_WINDOW = 30.0
_UNKNOWN_ATTITUDE = np.empty((0, 0))
_NO_RIMS = ResectionResult(Status.TOO_FEW_RIMS, "found no rim, expected one or more", ())


@dataclass(frozen=True)
class SolveOptions:
    """How poses are searched, and which are reported.

    Attributes
    ----------
    planes : int
        Rims, the best measured first, from which initial poses are made; each gives two.
    rolls : int
        Initial poses per plane of a single rim, over the rotation about its normal that it leaves free.
    iterations : int
        Largest number of linearisations of one minimisation.
    least_probability : float
        Less probable solutions are left out, unless `raised` forbids it.
    raised : float
        What is left out raises the mean squared error of no component by more than this share of the most
        probable solution's variance: 0.1 keeps the standard deviations true to 5 %.
    misfit_sigma : float
        A cost this many standard deviations above its expectation means that the data contradict each other.
    noise_allowance : float
        Factor on that limit: chart errors of the smallest rims have heavier tails than Gaussian ones.
    """

    planes: int = 2
    rolls: int = 64
    iterations: int = 3000
    least_probability: float = 0.01
    raised: float = 0.1
    misfit_sigma: float = 5.0
    noise_allowance: float = 1.6


def solve(problem: ResectionProblem, options: SolveOptions = SolveOptions()) -> ResectionResult:
    """Estimate the pose of an image from its matched rims.

    Parameters
    ----------
    problem : ResectionProblem
        A single rim determines a pose only with a prior, a known attitude or the sun.
    options : SolveOptions

    Returns
    -------
    ResectionResult
        Every pose is a local minimum of the cost; its probability, by Laplace's approximation, follows from
        cost and information.
    """
    if not len(problem.rims):
        return _NO_RIMS
    return _judge(problem, options, *local_minima(problem, options))


def refine(
    problem: ResectionProblem, gTb: FloatArray, options: SolveOptions = SolveOptions()
) -> ResectionResult:
    """Estimate the pose of an image from a start: the local minimum that it leads to, and no other.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Initial pose; its attitude is replaced by a known one.
    options : SolveOptions

    Returns
    -------
    ResectionResult
        With one pose, or none.
    """
    if not len(problem.rims):
        return _NO_RIMS
    pose = np.array(gTb, dtype=np.float64)
    if problem.attitude is not None:
        pose[:3, :3] = problem.attitude.gRb
    N = np.empty((1, 6, 6))
    prior, weight = problem.prior_arrays()
    cost, converged = minimise(
        pose, problem.bTc, problem.rims.packed(problem.bTc), prior, weight, problem.sun_array(), 1.0,
        problem.first_free, options.iterations, N[0],
    )  # fmt: skip
    return _judge(problem, options, pose[None], np.array([cost]), N, np.array([converged]))


def _judge(
    problem: ResectionProblem, options: SolveOptions, gTb: FloatArray, costs: FloatArray, N: FloatArray,
    converged: BoolArray,
) -> ResectionResult:  # fmt: skip
    """Convert local minima, lowest cost first, to a result: do they fit, are they determined and probable."""
    # The negated form is also true for NaN.
    if not len(costs) or not costs[0] < UNSEEN**2:
        return ResectionResult(
            Status.NO_POSE, "no pose has all rims in front of the camera and seen from above", ()
        )
    if costs[0] > largest_cost(problem, options):
        return ResectionResult(Status.NO_POSE, _misfit(problem, options, gTb[0], costs[0]), ())
    first = problem.first_free
    range_m = problem.range_m(gTb[0])
    covariances, logs = np.empty_like(N), np.empty(len(N))
    for k in range(len(N)):
        logs[k] = covariance_and_log_det(N[k], first, covariances[k])
    variance = covariances[0].diagonal().tolist()
    if not sum(variance[:3]) + sum(variance[3:]) / range_m**2 <= MAX_SIGMA**2:
        seen = observability(problem, gTb[0], N[0])
        if len(seen.free):
            reason = f"rank {seen.rank}, undetermined: " + "; ".join(seen.words)
            covariances[:] = np.nan
            shares = _shares(-0.5 * (costs - costs[0]))
            return ResectionResult(
                Status.UNDETERMINED, reason, _poses(problem, gTb, covariances, costs, shares)
            )
    # A minimisation that ended where a rim turns invisible, or by its limit of iterations, gives no minimum;
    # nor does one whose information is not positive definite.
    minimum = converged & np.isfinite(logs)
    minimum[0] = True
    shares = _shares(np.where(minimum, -0.5 * (costs - costs[0] + logs - logs[0]), -np.inf))
    order = np.argsort(-shares, kind="stable")
    apart2 = np.array([squared_distance(gTb[order[0]], gTb[k], N[order[0]]) for k in order])
    reported = _reported(shares[order], apart2, options)
    order, apart2 = order[reported], apart2[reported]
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
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Find the local minima of a problem's cost.

    Parameters
    ----------
    problem : ResectionProblem
    options : SolveOptions

    Returns
    -------
    gTb : ndarray, shape (k, 4, 4)
        The distinct minima, lowest cost first.
    cost : ndarray, shape (k,)
        Squared norms of the whitened residuals.
    N : ndarray, shape (k, 6, 6)
        Information for the right twist in b, rad and m.
    converged : ndarray of bool, shape (k,)
    """
    rims = problem.rims
    prior, weight = problem.prior_arrays()
    attitude = _UNKNOWN_ATTITUDE if problem.attitude is None else problem.attitude.gRb
    spread = rims.covariance[:, 2, 2] + rims.covariance[:, 4, 4]
    reference = np.argsort(spread)[: options.planes]
    return solutions(
        problem.bTc, rims.centres, rims.axes, rims.chart, rims.whitening, prior, weight, problem.sun_array(),
        attitude, problem.first_free, reference, options.rolls, options.iterations, _COST_WINDOW,
    )  # fmt: skip


def largest_cost(problem: ResectionProblem, options: SolveOptions) -> float:
    """Compute the cost above which the data contradict each other.

    Parameters
    ----------
    problem : ResectionProblem
    options : SolveOptions

    Returns
    -------
    float
        Quantile of the chi-square distribution by Wilson and Hilferty's approximation, with an allowance.
    """
    first = problem.first_free
    rows = 5 * len(problem.rims) + (problem.sun is not None) + 6 * (problem.prior is not None)
    rows += 3 * (problem.attitude is not None and first == 0)
    freedom = max(rows - (6 - first), 1)
    share = 2.0 / (9.0 * freedom)
    return float(
        options.noise_allowance * freedom * (1.0 - share + options.misfit_sigma * np.sqrt(share)) ** 3
    )


def _misfit(problem: ResectionProblem, options: SolveOptions, gTb: FloatArray, cost: float) -> str:
    """Describe the misfit of the best pose, and name what is probably wrong.

    The residuals at the best pose do not show it: a weak source gives way to a strong wrong one. A source is
    blamed when all others agree without it.
    """
    sources = {"prior": problem.prior, "attitude": problem.attitude, "sun": problem.sun}
    given = [name for name, value in sources.items() if value is not None]
    text = f"the best pose leaves a squared norm of {cost:.3g}"
    if given and len(problem.rims) == 1:
        what = " or the ".join(given)
        return f"{text}: the match of crater {problem.rims.identifiers[0]!r} or the {what} is wrong"
    blamed = []
    for name in given:
        others = replace(problem, **{name: None})  # type: ignore[arg-type]
        _, costs, _, _ = local_minima(others, options)
        if len(costs) and costs[0] <= largest_cost(others, options):
            blamed.append(name)
    if blamed:
        match = ", or a match is wrong" if len(problem.rims) == 2 else ""
        return f"{text}: the {' or the '.join(blamed)} contradicts the rest, which agrees without it{match}"
    each = np.sum(problem.rims.residuals(gTb, problem.bTc) ** 2, axis=1)
    k = int(np.argmax(each))
    return (
        f"{text}, the largest part from the rim of crater {problem.rims.identifiers[k]!r} ({each[k]:.3g}): "
        "a wrong match, the wrong camera, or too small a sigma"
    )


def _shares(logs: FloatArray) -> FloatArray:
    """Probabilities of minima whose unnormalised logarithms are given."""
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def _reported(shares: FloatArray, apart2: FloatArray, options: SolveOptions) -> BoolArray:
    """Mask of the solutions to report; `apart2` are squared Mahalanobis distances from the first."""
    reported = shares >= options.least_probability
    # No component differs by more, in units of its variance, than the squared distance.
    effect = shares * apart2
    rank = np.argsort(effect)
    reported[rank[np.cumsum(effect[rank]) > options.raised]] = True
    reported[0] = True
    return np.asarray(reported)


def _poses(
    problem: ResectionProblem, gTb: FloatArray, covariances: FloatArray, costs: FloatArray,
    shares: FloatArray,
) -> tuple[PoseSolution, ...]:  # fmt: skip
    """Make solutions of poses, their covariances, costs and probabilities."""
    return tuple(
        PoseSolution(T, covariance, problem.rims.residuals(T, problem.bTc), float(cost), float(share))
        for T, covariance, cost, share in zip(gTb, covariances, costs, shares, strict=True)
    )
