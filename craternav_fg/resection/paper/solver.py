"""Solver for the paper's resection methods: the pose near a start from one image's rims.

Sums of squares without weights are minimised, as published; only the sign of eq. (11) is corrected. The
covariance is that of an unweighted estimate, (J'J)^-1 J' N J (J'J)^-1 with N from the charts' noise, to first
order. It does not include the bias of eq. (10), which takes image centres for images of centres.

References
----------
Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966; docs/equations.md.
"""

from dataclasses import replace
from enum import Enum
from functools import partial

import numpy as np
from scipy.special import chdtri

from craternav_fg import frames
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.efficient import refine
from craternav_fg.resection.least_squares import (
    EVERYTHING,
    TRANSLATION,
    PoseEquations,
    minimise,
    pseudo_inverse,
)
from craternav_fg.resection.paper import equations
from craternav_fg.resection.paper.centres import centre_covariance, centre_pose
from craternav_fg.resection.paper.equations import PaperRims
from craternav_fg.resection.problem import (
    PosePrior,
    PoseSolution,
    ResectionError,
    ResectionProblem,
    ResectionResult,
    Status,
)
from factors.arrays import FloatArray
from factors.kernels import conic

# Squared distance from the prior beyond which the pose from a single crater is rejected: the quantile
# 1 - 1e-4 of the chi-square distribution of six degrees of freedom.
_PRIOR_GATE = float(chdtri(6, 1e-4))


class Method(Enum):
    """A resection method of the paper, by its equation."""

    IMAGE_CENTRES = "(10)"
    EDGES = "(13)"
    TWO_CRATERS = "(23)"
    SHAPES = "(19)"
    CRATER_AND_SUN = "(25)"


# Fewest rims with an unknown and with a known attitude.
_MIN_RIMS = {
    Method.IMAGE_CENTRES: (3, 3),
    Method.EDGES: (3, 2),
    Method.TWO_CRATERS: (2, 2),
    Method.SHAPES: (2, 1),
    Method.CRATER_AND_SUN: (1, 1),
}


def solve_paper(
    problem: ResectionProblem, method: Method, start: FloatArray | None = None
) -> ResectionResult:
    """Estimate the pose by a method of the paper.

    Parameters
    ----------
    problem : ResectionProblem
        Its prior only gives the start and, for a single crater, a gate on the solution. A known attitude is
        taken as exact. Only `CRATER_AND_SUN` uses the sun, in perspective and with atan2.
    method : Method
        `IMAGE_CENTRES` takes the centres of image ellipses for the images of the craters' centres, as the
        paper's baseline does.
    start : ndarray, shape (4, 4), optional
        Initial pose gTb; by default the prior's. The equations have several solutions; the one near the start
        is found.

    Returns
    -------
    ResectionResult
        With one pose, or with none and the reason. There is also none when the rims contradict each other,
        that is when no pose near the solution explains their charts.

    Raises
    ------
    ResectionError
        When there is neither a start nor a prior; for `CRATER_AND_SUN`, when there is no sun or more than one
        crater.
    """
    if start is None:
        if problem.prior is None:
            raise ResectionError(f"eq. {method.value}: expected a start or a prior, found neither")
        start = problem.prior.gTb
    least = _MIN_RIMS[method][problem.attitude is not None]
    if len(problem.rims) < least:
        reason = f"eq. {method.value}: expected {least} rims or more, found {len(problem.rims)}"
        return ResectionResult(Status.TOO_FEW_RIMS, reason, ())
    free = EVERYTHING
    if problem.attitude is not None:
        start, free = frames.pose(problem.attitude.gRb, start[:3, 3]), TRANSLATION
    seen = PaperRims(problem.rims)
    gTc = start @ problem.bTc
    if method is Method.IMAGE_CENTRES:
        gTc, converged = centre_pose(seen, gTc, free)
        covariance = centre_covariance(seen, gTc, free)
    else:
        system = _system(problem, method, seen)
        gTc, converged = minimise(system, gTc, free)
        covariance = None
        inverse = pseudo_inverse(system(gTc)[1][:, free])
        if inverse is not None:
            covariance = np.zeros((6, 6))
            covariance[free, free] = inverse @ _noise(problem, method, seen, gTc) @ inverse.T
    return _result(problem, method, gTc, converged, covariance)


def _system(problem: ResectionProblem, method: Method, seen: PaperRims) -> PoseEquations:
    """Equations of a method that is minimised over the whole pose."""
    if method is Method.EDGES:
        return partial(equations.edges, seen)
    if method is Method.TWO_CRATERS:
        return partial(equations.two_craters, seen)
    if method is Method.SHAPES:
        return partial(equations.conic_shapes, seen)
    if problem.sun is None:
        raise ResectionError("eq. (25): expected the sun's tilt, found none")
    if len(problem.rims) > 1:
        raise ResectionError(f"eq. (25): expected one crater, found {len(problem.rims)}")
    return partial(equations.with_sun, problem.sun, seen)


def _noise(problem: ResectionProblem, method: Method, seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Covariance (m, m) of the residual of those equations."""
    if method is Method.EDGES:
        return equations.edges_noise(seen, gTc)
    if method is Method.TWO_CRATERS:
        return equations.two_craters_noise(seen, gTc)
    if method is Method.SHAPES:
        return equations.conic_shapes_noise(seen, gTc)
    assert problem.sun is not None
    return equations.with_sun_noise(problem.sun, seen, gTc)


def _result(
    problem: ResectionProblem, method: Method, gTc: FloatArray, converged: bool, covariance: FloatArray | None
) -> ResectionResult:
    """Check a solution, and turn it into a result for the body."""
    name = f"eq. {method.value}"
    if not converged:
        return ResectionResult(Status.NOT_CONVERGED, f"{name} did not converge", ())
    gTb = np.ascontiguousarray(gTc @ frames.inverse(problem.bTc))
    rims = problem.rims
    _, visible = conic.project_rims(gTb, problem.bTc, rims.centres, rims.axes)
    if not visible.all():
        hidden = rims.identifiers[int(np.argmin(visible))]
        return ResectionResult(
            Status.NO_POSE, f"at the solution of {name} the rim of crater {hidden!r} is not visible", ()
        )
    # The equations' own residuals are biased or ignore shapes. The same test for every method is whether the
    # maximum-likelihood pose nearby explains the charts.
    nearby = refine(_as_the_paper(problem, method, gTb), gTb)
    if nearby.status is Status.NO_POSE:
        return nearby
    residuals = rims.residuals(gTb, problem.bTc)
    turn = frames.adjoint(problem.bTc)
    S = np.full((6, 6), np.nan) if covariance is None else turn @ covariance @ turn.T
    pose = PoseSolution(gTb, S, residuals, float(np.sum(residuals**2)))
    if covariance is None:
        return ResectionResult(Status.UNDETERMINED, f"{name} does not determine the whole pose", (pose,))
    if method is Method.CRATER_AND_SUN:
        if problem.prior is None:
            reason = "one crater and the sun's tilt allow several poses; this is the one near the start"
            return ResectionResult(Status.AMBIGUOUS, reason, (pose,))
        distance = _distance(problem.prior, gTb)
        if distance > _PRIOR_GATE:
            reason = f"the solution of {name} is {np.sqrt(distance):.0f} standard deviations from the prior"
            return ResectionResult(Status.NO_POSE, reason, ())
    return ResectionResult(Status.SOLVED, "", (pose,))


def _as_the_paper(problem: ResectionProblem, method: Method, gTb: FloatArray) -> ResectionProblem:
    """Reduce a problem to what a method uses: no prior, an exact attitude, the sun for one method only."""
    attitude = None if problem.attitude is None else KnownAttitude(gTb[:3, :3])
    sun = problem.sun if method is Method.CRATER_AND_SUN else None
    return replace(problem, prior=None, attitude=attitude, sun=sun)


def _distance(prior: PosePrior, gTb: FloatArray) -> float:
    """Squared distance of a pose from the prior, in standard deviations."""
    step = frames.inverse(prior.gTb) @ gTb
    twist = np.concatenate([frames.rotation_log(step[:3, :3]), step[:3, 3]])
    return float(squared_distance(twist, prior.covariance))
