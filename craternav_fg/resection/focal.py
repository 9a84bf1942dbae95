"""Scale of the focal length as a seventh unknown: check of the camera's value, effect of its error.

An error of the focal length moves the camera nearer to the ground or farther away. Only perspective, the
ground's curvature and tilted views tell the two apart, so the prior of the focal length often decides.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.resection.problem import ResectionProblem, ResectionResult, Status
from craternav_fg.resection.solve_kernel import normal_equations
from factors.kernels import packed
from factors.kernels.gauss_newton import screw
from factors.kernels.robust import NONE

FloatArray = npt.NDArray[np.float64]

# Relative standard deviation of a camera's focal length unless another is known: one that is off by 1 % where
# the rims cannot tell leaves the pose within five standard deviations.
FOCAL_SIGMA = 0.003
# Steps of a fit at most, and change of the focal length's logarithm, over its sigma, that is the last.
_STEPS, _LAST_STEP = 10, 1e-3
# A step is shortened so that this logarithm changes by at most so much.
_MAX_STEP = 0.1
# Largest logarithm that is reported.
_MAX_LOG_SCALE = 2.0
# Deviation from the prior, in standard deviations, from which the focal length is taken to be wrong.
_MAX_DEVIATION = 3.5
# Standard deviation above which the rims are said not to check the focal length.
_UNCHECKED_SIGMA = 0.006


@dataclass(frozen=True)
class FocalFit:
    """A pose with the scale of the focal length as a further unknown.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b, the unknown focal length included.
    shift : ndarray, shape (6,)
        Right twist by which the pose moves with the logarithm of the focal length, rad and m in b.
    log_scale, log_scale_sigma : float
        Logarithm of the true focal length over the camera's, by rims and prior, and its standard deviation.
    scale : float
        True focal length over the camera's, by the rims alone.
    scale_sigma : float
        Its relative standard deviation; inf when the rims do not tell.
    """

    gTb: FloatArray
    covariance: FloatArray
    shift: FloatArray
    log_scale: float
    log_scale_sigma: float
    scale: float
    scale_sigma: float


def fit_focal(problem: ResectionProblem, gTb: FloatArray, sigma: float) -> FocalFit:
    """Fit pose and focal length by Gauss-Newton steps.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Initial pose.
    sigma : float
        Relative standard deviation of the camera's focal length.

    Returns
    -------
    FocalFit
    """
    first = problem.first_free
    pose, log_scale = np.array(gTb, dtype=np.float64), 0.0
    for _ in range(_STEPS):
        A, gradient = _normal_equations(problem, pose, log_scale, sigma)
        moved = -np.linalg.solve(A, gradient)
        moved *= min(1.0, _MAX_STEP / max(abs(moved[-1]), _MAX_STEP))
        twist = np.zeros(6)
        twist[first:] = moved[:-1]
        screw(pose, twist)
        log_scale += float(moved[-1])
        if abs(moved[-1]) < _LAST_STEP * sigma:
            break
    inverse = np.linalg.inv(A)
    covariance, shift = np.zeros((6, 6)), np.zeros(6)
    covariance[first:, first:] = inverse[:-1, :-1]
    shift[first:] = inverse[:-1, -1] / inverse[-1, -1]
    information = 1.0 / inverse[-1, -1]
    # Without the prior: of a linear problem.
    by_rims = max(information - sigma**-2, 0.0)
    alone = log_scale * information / by_rims if by_rims else 0.0
    return FocalFit(
        gTb=pose,
        covariance=covariance,
        shift=shift,
        log_scale=log_scale,
        log_scale_sigma=float(information**-0.5),
        scale=float(np.exp(np.clip(alone, -_MAX_LOG_SCALE, _MAX_LOG_SCALE))),
        scale_sigma=float(by_rims**-0.5) if by_rims else np.inf,
    )


def _normal_equations(
    problem: ResectionProblem, gTb: FloatArray, log_scale: float, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Compute matrix (k, k) and gradient (k,) for the pose's free coordinates and the logarithm."""
    rims, first = problem.rims, problem.first_free
    prior, weight = problem.prior_arrays()
    out, N, g = np.empty((7, 5 * len(rims))), np.empty((6, 6)), np.empty(6)
    chart = rims.chart.copy()
    chart[:, :2] *= np.exp(-log_scale)
    chart[:, [2, 4]] -= log_scale
    data = packed.pack(problem.bTc, rims.centres, rims.axes, chart, rims.whitening, NONE, 1.0)
    normal_equations(gTb, problem.bTc, data, prior, weight, problem.sun_array(), 1.0, out, N, g)
    change = np.ones((len(rims), 5))
    change[:, :2], change[:, 3] = chart[:, :2], 0.0
    column = (rims.whitening @ change[..., None]).ravel()
    A = np.empty((7 - first, 7 - first))
    A[:-1, :-1] = N[first:, first:]
    A[:-1, -1] = A[-1, :-1] = out[first:6] @ column
    A[-1, -1] = column @ column + sigma**-2
    return A, np.append(g[first:], column @ out[6] + log_scale * sigma**-2)


def with_unknown_focal(
    problem: ResectionProblem, result: ResectionResult, sigma: float = FOCAL_SIGMA
) -> ResectionResult:
    """Include the uncertainty of the focal length in a result, and warn when the rims contradict it.

    Parameters
    ----------
    problem : ResectionProblem
    result : ResectionResult
        Result of `solve` or `solve_robustly`.
    sigma : float
        Relative standard deviation of the camera's focal length.

    Returns
    -------
    ResectionResult
        With the fitted poses, if there are any.
    """
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS):
        return result
    kept = np.array([name not in result.wrong for name in problem.rims.identifiers])
    scaled = problem.inflated(result.sigma_scale)
    part = replace(scaled, rims=scaled.rims.take(kept))
    fits = [fit_focal(part, pose.gTb, sigma) for pose in result.poses]
    poses = tuple(
        replace(
            pose, gTb=fit.gTb, covariance=fit.covariance,
            residuals=scaled.rims.residuals(fit.gTb, problem.bTc),
        )
        for pose, fit in zip(result.poses, fits, strict=True)
    )  # fmt: skip
    best = fits[0]
    return replace(
        result,
        poses=poses,
        warnings=(*result.warnings, *focal_warnings(best.scale, best.scale_sigma, sigma)),
        focal_scale=best.scale,
        focal_scale_sigma=best.scale_sigma,
    )


def focal_warnings(scale: float, scale_sigma: float, sigma: float) -> tuple[str, ...]:
    """Say whether the rims contradict the camera's focal length, or cannot check it.

    Parameters
    ----------
    scale : float
        Focal length from the rims alone, over the camera's.
    scale_sigma : float
        Its relative standard deviation.
    sigma : float
        Relative standard deviation of the camera's focal length.

    Returns
    -------
    tuple of str
        At most one line.
    """
    percent = f"{100.0 * (scale - 1.0):+.2g} +- {100.0 * scale_sigma:.2g} %"
    # Also true for NaN.
    if not abs(np.log(scale)) < _MAX_DEVIATION * np.hypot(scale_sigma, sigma):
        return (
            f"the rims contradict the camera's focal length: theirs differs by {percent}, with an expected "
            f"{100.0 * sigma:.2g} %; check the intrinsics, the size of the image and the body",
        )
    if scale_sigma > _UNCHECKED_SIGMA:
        return (
            f"these rims cannot check the camera's focal length (theirs differs by {percent}): its error is "
            "one of the distance to the ground in the same ratio",
        )
    return ()
