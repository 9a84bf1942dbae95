"""Focal length and principal point as further unknowns: check of the camera's values, effect of their errors.

An error of the focal length moves the camera nearer to the ground or farther away, one of the principal point
turns it. Only perspective, the ground's curvature and tilted views tell them from the pose, so their priors
often decide.
"""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.resection.problem import MatchedRims, ResectionProblem, ResectionResult, Status
from craternav_fg.resection.solve_kernel import normal_equations
from factors.arrays import FloatArray
from factors.kernels import packed
from factors.kernels.conic import project_rims
from factors.kernels.gauss_newton import screw
from factors.kernels.robust import NONE

# Relative standard deviation of a camera's focal length unless another is known: one that is off by 1 % where
# the rims cannot tell leaves the pose within five standard deviations.
FOCAL_SIGMA = 0.003
# Standard deviation of each coordinate of the principal point, px, unless another is known: conventions of
# where the first pixel's centre is differ by 0.5 or 1 px.
PRINCIPAL_SIGMA_PX = 0.5
# Steps of a fit at most, and predicted decrease of the cost below which it has converged: a step below
# 1e-3 standard deviations.
_STEPS, _MIN_GAIN = 50, 1e-6
# A step is shortened so that the focal length's logarithm changes by at most so much.
_MAX_STEP = 0.1
# Largest logarithm that is reported.
_MAX_LOG_SCALE = 2.0
# Deviation, in standard deviations, from which an intrinsic is taken to be wrong; the same probability for
# the principal point's two coordinates together.
_MAX_DEVIATION = 3.5
_MAX_DEVIATION_OF_TWO = 3.9
# Deviation from which rims that cannot refute a focal length do not agree with it either: chance exceeds it
# once in 80.
_DOUBTFUL_SIGMAS = 2.5
# A principal point that is off by less than so many standard deviations of its prior is as expected.
_EXPECTED_SIGMAS = 2.0
# Relative error of the focal length that must not go unnoticed; standard deviation up to which the rims show
# it in 999 of 1000 images; and how far, in standard deviations, a smaller one may take the pose.
_FEARED_ERROR, _UNCHECKED_SIGMA, _HARMLESS_SIGMAS = 0.05, 0.007, 5.0


@dataclass(frozen=True)
class IntrinsicsPrior:
    """How well the intrinsics of a camera are known.

    Attributes
    ----------
    focal_px : float
        The camera's focal length.
    focal_sigma_share : float
        Relative standard deviation of the focal length; 0 for an exact one.
    principal_sigma_px : float
        Standard deviation of each coordinate of the principal point; 0 for an exact one.
    focal_stated : bool
        Whether the user has stated how well the focal length is known: then no warning says that the rims
        cannot check it.
    """

    focal_px: float
    focal_sigma_share: float = FOCAL_SIGMA
    principal_sigma_px: float = PRINCIPAL_SIGMA_PX
    focal_stated: bool = False

    @classmethod
    def of(cls, camera: Camera) -> "IntrinsicsPrior":
        """Take what a camera states, else the usual sigmas.

        Parameters
        ----------
        camera : Camera

        Returns
        -------
        IntrinsicsPrior
        """
        percent, principal_px = camera.focal_sigma_percent, camera.principal_sigma_px
        return cls(
            camera.focal_px,
            FOCAL_SIGMA if percent is None else 0.01 * percent,
            PRINCIPAL_SIGMA_PX if principal_px is None else principal_px,
            focal_stated=percent is not None,
        )

    @property
    def sigmas(self) -> FloatArray:
        """Sigmas (3,) of the unknowns: logarithm of the focal length, principal point in c, over it."""
        principal = self.principal_sigma_px / self.focal_px
        return np.array([self.focal_sigma_share, principal, principal])


@dataclass(frozen=True)
class IntrinsicsFit:
    """A pose with the intrinsics as further unknowns.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b, the unknown intrinsics included.
    effect : ndarray, shape (6, 3)
        Right twist by which the pose moves with each unknown, rad and m in b.
    unknowns : ndarray, shape (3,)
        By rims and prior, numbers without unit: logarithm of the true focal length over the camera's; true
        less the camera's principal point in c, over the focal length.
    unknowns_covariance : ndarray, shape (3, 3)
        Their covariance, numbers without unit, the latter two in c; zero for those that are exact.
    focal_scale : float
        True focal length over the camera's, by the rims alone; NaN when it is exact.
    focal_scale_sigma : float
        Its relative standard deviation; inf when the rims do not tell.
    principal_shift_px : ndarray, shape (2,)
        True less the camera's principal point, by the rims alone; NaN when it is exact or they do not tell.
    principal_covariance_px2 : ndarray, shape (2, 2)
        Covariance of the shift.
    cost : float
        Squared norm of all whitened residuals, those of the prior of the intrinsics included.
    converged : bool
        False when no minimum below the cost of the initial pose was found: all the rest is then of that pose,
        with the camera's intrinsics.
    """

    gTb: FloatArray
    covariance: FloatArray
    effect: FloatArray
    unknowns: FloatArray
    unknowns_covariance: FloatArray
    focal_scale: float
    focal_scale_sigma: float
    principal_shift_px: FloatArray
    principal_covariance_px2: FloatArray
    cost: float
    converged: bool


@dataclass(frozen=True)
class _Linearised:
    """Pose and unknowns (3,), the cost there, and its normal equations for their free coordinates.

    `jacobian` (k, 5n) and `residuals` (5n,) are those of the rims alone.
    """

    gTb: FloatArray
    unknowns: FloatArray
    cost: float
    A: FloatArray
    gradient: FloatArray
    jacobian: FloatArray
    residuals: FloatArray


def fit_intrinsics(problem: ResectionProblem, gTb: FloatArray, prior: IntrinsicsPrior) -> IntrinsicsFit:
    """Fit pose and intrinsics by Gauss-Newton steps.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Initial pose; it sees the rims.
    prior : IntrinsicsPrior

    Returns
    -------
    IntrinsicsFit
    """
    first, sigmas = problem.first_free, prior.sigmas
    free = np.flatnonzero(sigmas)
    own = 6 - first
    fit, converged = _minimised(problem, gTb, sigmas)
    unknowns, inverse = fit.unknowns, np.linalg.inv(fit.A)
    covariance, effect, of_unknowns = np.zeros((6, 6)), np.zeros((6, 3)), np.zeros((3, 3))
    covariance[first:, first:] = inverse[:own, :own]
    effect[first:, free] = np.linalg.solve(inverse[own:, own:], inverse[own:, :own]).T
    of_unknowns[np.ix_(free, free)] = inverse[own:, own:]
    log_scale, log_scale_variance = _by_rims(unknowns[:1], of_unknowns[:1, :1], sigmas[0])
    shift, shift_covariance = _by_rims(unknowns[1:], of_unknowns[1:, 1:], sigmas[1])
    return IntrinsicsFit(
        gTb=fit.gTb,
        covariance=covariance,
        effect=effect,
        unknowns=unknowns,
        unknowns_covariance=of_unknowns,
        focal_scale=float(np.exp(np.clip(log_scale[0], -_MAX_LOG_SCALE, _MAX_LOG_SCALE))),
        focal_scale_sigma=float(np.sqrt(log_scale_variance[0, 0])),
        principal_shift_px=prior.focal_px * shift,
        principal_covariance_px2=prior.focal_px**2 * shift_covariance,
        cost=fit.cost,
        converged=converged,
    )


def _minimised(problem: ResectionProblem, gTb: FloatArray, sigmas: FloatArray) -> tuple[_Linearised, bool]:
    """Minimise the cost over pose and unknowns; return the start, and False, when it did not converge."""
    first, free = problem.first_free, np.flatnonzero(sigmas)
    own = 6 - first
    start = at = _linearised(problem, np.array(gTb, dtype=np.float64), np.zeros(3), sigmas)
    for _ in range(_STEPS):
        try:
            step = -np.linalg.solve(at.A, at.gradient)
        except np.linalg.LinAlgError:
            # The last step led to where the rims are not seen.
            return start, False
        if -at.gradient @ step < _MIN_GAIN:
            return (at, True) if at.cost <= start.cost else (start, False)
        if sigmas[0]:
            step *= min(1.0, _MAX_STEP / max(abs(step[own]), _MAX_STEP))
        twist, unknowns, pose = np.zeros(6), at.unknowns.copy(), at.gTb.copy()
        twist[first:] = step[:own]
        unknowns[free] += step[own:]
        screw(pose, twist)
        # The cost may rise on the way: distance and focal length lie in a curved valley, and steps that never
        # raise it are short there.
        at = _linearised(problem, pose, unknowns, sigmas)
    return start, False


def _by_rims(estimate: FloatArray, covariance: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Estimate (k,) and covariance (k, k) without the prior, as in a linear problem; NaN for exact ones."""
    k = len(estimate)
    if not sigma:
        return np.full(k, np.nan), np.full((k, k), np.nan)
    with_prior = np.linalg.inv(covariance)
    alone = with_prior - sigma**-2 * np.eye(k)
    if not np.linalg.eigvalsh(alone)[0] > 0.0:
        return np.zeros(k), np.diag(np.full(k, np.inf))
    return np.asarray(np.linalg.solve(alone, with_prior @ estimate)), np.asarray(np.linalg.inv(alone))


def _corrected(chart: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Charts (n, 5) as a camera with the true intrinsics would have them, given the unknowns (3,)."""
    out = chart.copy()
    out[:, :2] = np.exp(-unknowns[0]) * (chart[:, :2] - unknowns[1:])
    out[:, [2, 4]] -= unknowns[0]
    return out


def _as_fitted(rims: MatchedRims, unknowns: FloatArray) -> MatchedRims:
    """Rims as a camera with the true intrinsics would have measured them, given the unknowns (3,)."""
    shrunk = np.exp(-unknowns[0] * np.array([1.0, 1.0, 0.0, 0.0, 0.0]))
    covariance = shrunk[:, None] * rims.covariance * shrunk
    return replace(rims, chart=_corrected(rims.chart, unknowns), covariance=covariance)


def _linearised(
    problem: ResectionProblem, gTb: FloatArray, unknowns: FloatArray, sigmas: FloatArray
) -> _Linearised:
    """Compute cost, matrix (k, k) and gradient (k,) for the pose's free coordinates and the free unknowns."""
    rims, first = problem.rims, problem.first_free
    prior, weight = problem.prior_arrays()
    out, N, g = np.empty((7, 5 * len(rims))), np.empty((6, 6)), np.empty(6)
    scale = float(np.exp(unknowns[0]))
    # The prediction is what follows the intrinsics: corrected rims would agree better the smaller they are.
    whitening = rims.whitening * np.array([scale, scale, 1.0, 1.0, 1.0])
    chart = _corrected(rims.chart, unknowns)
    data = packed.pack(problem.bTc, rims.centres, rims.axes, chart, whitening, NONE, 1.0)
    cost = normal_equations(gTb, problem.bTc, data, prior, weight, problem.sun_array(), 1.0, out, N, g)
    predicted, seen = project_rims(gTb, problem.bTc, rims.centres, rims.axes)
    # Where they are measured, columns and residuals would share the rims' errors.
    change = np.zeros((3, len(rims), 5))
    change[0, seen, :2], change[0][np.ix_(seen, [2, 4])] = scale * predicted[seen, :2], 1.0
    change[1, seen, 0] = change[2, seen, 1] = 1.0
    free = np.flatnonzero(sigmas)
    columns = (rims.whitening @ change[free, ..., None]).reshape(len(free), -1)
    own = 6 - first
    A = np.empty((own + len(free), own + len(free)))
    A[:own, :own] = N[first:, first:]
    A[:own, own:] = out[first:6] @ columns.T
    A[own:, :own] = A[:own, own:].T
    A[own:, own:] = columns @ columns.T + np.diag(sigmas[free] ** -2.0)
    cost += float(np.sum((unknowns[free] / sigmas[free]) ** 2))
    gradient = np.append(g[first:], columns @ out[6] + unknowns[free] * sigmas[free] ** -2.0)
    jacobian = np.concatenate([out[first:6], columns])
    return _Linearised(gTb, unknowns, cost, A, gradient, jacobian, out[6])


def further_error(
    problem: ResectionProblem, fit: IntrinsicsFit, prior: IntrinsicsPrior, slopes: FloatArray
) -> tuple[float, float]:
    """Estimate one more error of all charts, to first order, with pose and intrinsics free to follow it.

    Parameters
    ----------
    problem : ResectionProblem
    fit : IntrinsicsFit
        Of this problem.
    prior : IntrinsicsPrior
        That of the fit.
    slopes : ndarray, shape (n, 5)
        Derivatives of the charts, normalised coordinates, in the error.

    Returns
    -------
    value, sigma : float
        In the unit that `slopes` refer to; a sigma of inf when pose and intrinsics explain any error.
    """
    at = _linearised(problem, fit.gTb, fit.unknowns, prior.sigmas)
    column = (problem.rims.whitening @ slopes[..., None]).ravel()
    shared = at.jacobian @ column
    follow = np.linalg.solve(at.A, np.column_stack([shared, at.gradient]))
    information = float(column @ column - shared @ follow[:, 0])
    if not information > 0.0:
        return 0.0, np.inf
    return float(shared @ follow[:, 1] - column @ at.residuals) / information, information**-0.5


def with_unknown_intrinsics(
    problem: ResectionProblem, result: ResectionResult, prior: IntrinsicsPrior
) -> ResectionResult:
    """Include the uncertainty of the intrinsics in a result, and warn when the rims contradict them.

    Parameters
    ----------
    problem : ResectionProblem
    result : ResectionResult
        Result of `solve` or `solve_robustly`.
    prior : IntrinsicsPrior

    Returns
    -------
    ResectionResult
        With the fitted poses, if there are any, and residuals of rims as the fitted intrinsics show them.
    """
    if result.status not in (Status.SOLVED, Status.AMBIGUOUS) or not prior.sigmas.any():
        return result
    kept = np.array([name not in result.wrong for name in problem.rims.identifiers])
    scaled = problem.inflated(result.sigma_scale)
    part = replace(scaled, rims=scaled.rims.take(kept))
    fits = [fit_intrinsics(part, pose.gTb, prior) for pose in result.poses]
    poses = tuple(
        replace(
            pose, gTb=fit.gTb, covariance=fit.covariance, cost=fit.cost,
            residuals=_as_fitted(scaled.rims, fit.unknowns).residuals(fit.gTb, problem.bTc),
        )
        for pose, fit in zip(result.poses, fits, strict=True)
    )  # fmt: skip
    best = fits[0]
    return replace(
        result,
        poses=poses,
        warnings=(*result.warnings, *intrinsics_warnings(best, prior)),
        focal_scale=best.focal_scale,
        focal_scale_sigma=best.focal_scale_sigma,
    )


def intrinsics_warnings(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> tuple[str, ...]:
    """Return whether the rims contradict the camera's intrinsics, or leave a wrong focal length unnoticed.

    Parameters
    ----------
    fit : IntrinsicsFit
    prior : IntrinsicsPrior

    Returns
    -------
    tuple of str
        At most one line for the focal length, and one for the principal point; a single one when the fit did
        not converge.
    """
    if not fit.converged:
        return (
            "pose, focal length and principal point did not converge together: pose and standard deviations "
            "may be wrong; check the intrinsics, the size of the image and the body",
        )
    # A wrong focal length shifts the estimated principal point, too.
    return _contradicted_focal_length(fit, prior) or (
        *_unchecked_focal_length(fit, prior),
        *_contradicted_principal_point(fit, prior),
    )


def _contradicted_focal_length(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> tuple[str, ...]:
    # Also true for NaN.
    if not prior.focal_sigma_share or abs(np.log(fit.focal_scale)) < _focal_limit(fit, prior):
        return ()
    return (
        f"the rims contradict the camera's focal length: theirs differs by {_percent(fit)}, with an expected "
        f"{100.0 * prior.focal_sigma_share:.2g} %; check the intrinsics, the size of the image and the body",
    )


def _focal_limit(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> float:
    return _MAX_DEVIATION * _focal_sigma(fit, prior)


def _focal_sigma(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> float:
    """Sigma of the logarithm of the rims' focal length over the camera's."""
    return float(np.hypot(fit.focal_scale_sigma, prior.focal_sigma_share))


def _percent(fit: IntrinsicsFit) -> str:
    difference, sigma = 100.0 * (fit.focal_scale - 1.0), 100.0 * fit.focal_scale_sigma
    return f"{difference:+.{_digits(difference)}} +- {sigma:.{_digits(sigma)}} %"


def _digits(value: float) -> str:
    return "2g" if abs(value) < 10.0 else "0f"


def _unchecked_focal_length(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> tuple[str, ...]:
    if not prior.focal_sigma_share or prior.focal_stated or fit.focal_scale_sigma <= _UNCHECKED_SIGMA:
        return ()
    # A pose that is known less accurately anyway is not wrong by much.
    moved = min(_focal_limit(fit, prior), _FEARED_ERROR) * fit.effect[:, 0]
    free = np.diag(fit.covariance) > 0.0
    moved = moved[free]
    if moved @ np.linalg.solve(fit.covariance[np.ix_(free, free)], moved) < _HARMLESS_SIGMAS**2:
        return ()
    principal = ""
    if prior.principal_sigma_px and _widest(fit.principal_covariance_px2) > _UNCHECKED_SIGMA * prior.focal_px:
        principal = "; nor its principal point, whose error, as in a cropped image, turns the pose"
    known = (
        "its error is one of the distance to the ground in the same ratio; --focal-sigma-percent says how "
        f"well it is known{principal}"
    )
    doubt = abs(np.log(fit.focal_scale)) / _focal_sigma(fit, prior)
    if doubt > _DOUBTFUL_SIGMAS:
        return (
            f"these rims contradict by {doubt:.2g} sigma, which chance may explain, the camera's focal "
            f"length (theirs differs by {_percent(fit)}): {known}",
        )
    return (
        f"these rims cannot check the camera's focal length (theirs differs by {_percent(fit)}): {known}",
    )


def _widest(covariance: FloatArray) -> float:
    """Largest standard deviation along an axis; inf when one is."""
    return float(np.sqrt(np.diag(covariance).max()))


def _contradicted_principal_point(fit: IntrinsicsFit, prior: IntrinsicsPrior) -> tuple[str, ...]:
    shift, covariance = fit.principal_shift_px, fit.principal_covariance_px2
    if not (np.isfinite(shift).all() and np.isfinite(covariance).all()):
        return ()
    if np.linalg.norm(shift) < _EXPECTED_SIGMAS * prior.principal_sigma_px:
        return ()
    if shift @ np.linalg.solve(covariance, shift) < _MAX_DEVIATION_OF_TWO**2:
        return ()
    sigma = np.sqrt(np.diag(covariance))
    return (
        f"the rims contradict the camera's principal point: theirs differs by x {shift[0]:+.2g} +- "
        f"{sigma[0]:.1g}, y {shift[1]:+.2g} +- {sigma[1]:.1g} px, with an expected "
        f"{prior.principal_sigma_px:.2g} px; is the first pixel's centre at (0, 0)?",
    )
