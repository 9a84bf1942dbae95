"""The paper's static methods: one image's rims in, the pose nearest a start out.

Sums of squares without weights, as published; only the sign of eq. (11) is put right. The covariance is that
of an unweighted estimate, (J'J)^-1 J' N J (J'J)^-1 with N from the charts' noise, to first order; it knows
nothing of a bias, of which the centres of the image ellipses, eq. (10), have one.
"""

from dataclasses import replace
from enum import Enum
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

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
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]

# Squared distance from the prior, in its standard deviations, beyond which one crater's pose is not believed.
_PRIOR_GATE = float(chi2.isf(1e-4, 6))


class Method(Enum):
    """A static method of the paper, by its equation."""

    IMAGE_CENTRES = "(10)"
    EDGES = "(13)"
    TWO_CRATERS = "(23)"
    SHAPES = "(19)"
    CRATER_AND_SUN = "(25)"


# Fewest rims, and fewest when the attitude is known.
_LEAST = {
    Method.IMAGE_CENTRES: (3, 3),
    Method.EDGES: (3, 2),
    Method.TWO_CRATERS: (2, 2),
    Method.SHAPES: (2, 1),
    Method.CRATER_AND_SUN: (1, 1),
}


def solve_paper(
    problem: ResectionProblem, method: Method, start: FloatArray | None = None
) -> ResectionResult:
    """Solve for the pose with a method of the paper.

    Parameters
    ----------
    problem : ResectionProblem
        Its prior is a start only, and for one crater a gate on the solution. A known attitude is taken as
        exact. The sun is used by `CRATER_AND_SUN` alone, in perspective and with atan2.
    method : Method
        `IMAGE_CENTRES` takes the image ellipses' centres for the craters', as the paper's baseline does.
    start : ndarray, shape (4, 4), optional
        Pose of the body gTb to start from; the prior's if not given. The equations have several solutions,
        and the one near the start is found.

    Returns
    -------
    ResectionResult
        With one pose, or none and the reason. There is none, either, when the rims contradict each other:
        when no pose near the solution explains their charts, whatever the method makes of them.

    Raises
    ------
    ResectionError
        Without a start and without a prior; for `CRATER_AND_SUN` without the sun or with more craters.
    """
    if start is None:
        if problem.prior is None:
            raise ResectionError(f"eq. {method.value} needs a start or a prior")
        start = problem.prior.gTb
    least = _LEAST[method][problem.attitude is not None]
    if len(problem.rims) < least:
        reason = f"eq. {method.value} needs {least} rims, found {len(problem.rims)}"
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
    if method is Method.EDGES:
        return partial(equations.edges, seen)
    if method is Method.TWO_CRATERS:
        return partial(equations.two_craters, seen)
    if method is Method.SHAPES:
        return partial(equations.conic_shapes, seen)
    if problem.sun is None:
        raise ResectionError("eq. (25) needs the sun's tilt")
    if len(problem.rims) > 1:
        raise ResectionError(f"eq. (25) is of one crater, found {len(problem.rims)}")
    return partial(equations.with_sun, problem.sun, seen)


def _noise(problem: ResectionProblem, method: Method, seen: PaperRims, gTc: FloatArray) -> FloatArray:
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
    name = f"eq. {method.value}"
    if not converged:
        return ResectionResult(Status.NOT_CONVERGED, f"{name} did not converge", ())
    gTb = np.ascontiguousarray(gTc @ frames.inverse(problem.bTc))
    rims = problem.rims
    _, visible = conic.project_rims(gTb, problem.bTc, rims.centres, rims.axes)
    if not visible.all():
        hidden = rims.identifiers[int(np.argmin(visible))]
        return ResectionResult(
            Status.NO_POSE, f"from the solution of {name} the rim of {hidden} is not to be seen", ()
        )
    # The equations' own residuals are biased, or leave shapes out; the charts that the likeliest pose near
    # by leaves unexplained judge every method alike.
    likeliest = refine(_as_the_paper(problem, method, gTb), gTb)
    if likeliest.status is Status.NO_POSE:
        return likeliest
    residuals = rims.residuals(gTb, problem.bTc)
    turn = _adjoint(problem.bTc)
    S = np.full((6, 6), np.nan) if covariance is None else turn @ covariance @ turn.T
    pose = PoseSolution(gTb, S, residuals, float(np.sum(residuals**2)))
    if covariance is None:
        return ResectionResult(Status.UNDETERMINED, f"{name} leaves a direction of the pose free", (pose,))
    if method is Method.CRATER_AND_SUN:
        if problem.prior is None:
            reason = "one crater and the sun's tilt have several poses: this is the one near the start"
            return ResectionResult(Status.AMBIGUOUS, reason, (pose,))
        distance = _distance(problem.prior, gTb)
        if distance > _PRIOR_GATE:
            reason = f"the solution of {name} lies {np.sqrt(distance):.0f} standard deviations off the prior"
            return ResectionResult(Status.NO_POSE, reason, ())
    return ResectionResult(Status.SOLVED, "", (pose,))


def _as_the_paper(problem: ResectionProblem, method: Method, gTb: FloatArray) -> ResectionProblem:
    """Keep of the problem what a method uses: no prior, the attitude exact, the sun for one method."""
    attitude = None if problem.attitude is None else KnownAttitude(gTb[:3, :3])
    sun = problem.sun if method is Method.CRATER_AND_SUN else None
    return replace(problem, prior=None, attitude=attitude, sun=sun)


def _adjoint(T: FloatArray) -> FloatArray:
    """Matrix (6, 6) that turns the right twist of gTc into that of gTb = gTc T^-1, for T = bTc."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T[:3, :3]
    out[3:, :3] = equations.cross(T[None, :3, 3])[0] @ T[:3, :3]
    return out


def _distance(prior: PosePrior, gTb: FloatArray) -> float:
    """Squared distance of a pose from the prior, in standard deviations."""
    step = frames.inverse(prior.gTb) @ gTb
    twist = np.concatenate([frames.rotation_log(step[:3, :3]), step[:3, 3]])
    return float(squared_distance(twist, prior.covariance))
