"""The answer of a search: the refined pose of the body, its covariance, and the names of the craters."""

import time
from dataclasses import replace

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import share_of_rims
from craternav_fg.matching.identify.expansion import Expanded, Search
from craternav_fg.matching.identify.noise import shape_scale
from craternav_fg.matching.identify.pose_fit import fit_pose, pack_rims, shifts_without
from craternav_fg.matching.identify.refine import refine
from craternav_fg.matching.identify.result import Identification, Status
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.caveats import attitude_warnings
from craternav_fg.resection.intrinsics import (
    IntrinsicsFit,
    IntrinsicsPrior,
    fit_intrinsics,
    intrinsics_warnings,
)
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray, IntArray
from factors.kernels.gauss_newton import screw

# Squared shift of the pose without a pair, in standard deviations, less its expectation, that is usual:
# chosen. Few right answers over rendered real ground have more; two that wrong pairs had moved, 20 and 100.
_MOST_EXCESS = 8.0
# Of fewer pairs each pulls much, and the noise, which they hardly show, is wide.
_MIN_PAIRS = 6
# Covariance that makes nothing of a chart's shape, but for the size.
_UNKNOWN_SHAPE = np.zeros((5, 5))
_UNKNOWN_SHAPE[2:, 2:] = [[1.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 1.0]]
# Factor on the standard deviations of the intrinsics that the rims show: errors of the shapes of small rims
# are not Gaussian, and the focal length scatters 1.5 times as widely over simulated views.
_INTRINSICS_SPREAD = 2.0


def answer(
    expanded: Expanded, search: Search, once: IntArray, n: int, camera: Camera, began: float
) -> Identification:
    """Refine the pose, and give it for the body.

    Parameters
    ----------
    expanded : Expanded
        Changed: the refined pose of the camera.
    search : Search
    once : ndarray of int, shape (m,)
        Rows of the rims in the view among those that were given.
    n : int
        Number of those.
    camera : Camera
    began : float
        `time.perf_counter` when identification began, s.

    Returns
    -------
    Identification
    """
    index = search.index
    covariance = refine(
        search.view, index.craters, search.prior, search.weight, expanded.gTc, expanded.match, expanded.sigma
    )
    covariance += _pull(expanded, search, covariance)
    given = search.options
    prior = IntrinsicsPrior(
        search.view.focal_px, given.focal_sigma_share, given.principal_sigma_px, given.focal_stated
    )
    fit = _unknown_intrinsics(expanded, search, covariance, prior) if prior.sigmas.any() else None
    # From the camera's right twist to the body's.
    adjoint = frames.adjoint(camera.bTc)
    names = index.catalog.identifiers
    rows = np.full(n, -1)
    rows[once] = expanded.match
    gTb = expanded.gTc @ frames.inverse(camera.bTc)
    seen = index.catalog.take(rows[rows >= 0])
    share = 1.0
    warnings: tuple[str, ...] = ()
    if len(search.limits.attitude):
        share = share_of_rims(covariance[:3, :3], search.sigma_rad**2 * np.eye(3))
        known = KnownAttitude(search.limits.attitude @ camera.bTc[:3, :3].T, search.sigma_rad)
        warnings = attitude_warnings(known, gTb[:3, :3])
    of_b = adjoint @ covariance @ adjoint.T
    of_b += camera.mounting_covariance(share)
    of_map = seen.image_covariance(gTb, np.ones(len(seen)), share)
    return Identification(
        status=Status.IDENTIFIED,
        reason="",
        craters=tuple(names[row] if row >= 0 else None for row in rows),
        rows=rows,
        gTc=expanded.gTc,
        gTb=gTb,
        covariance=of_b + frames.rotate_position_block(of_map, gTb[:3, :3].T),
        log_chance=-expanded.log_ratio,
        sigma_px=float(expanded.sigma[0]),
        seconds=time.perf_counter() - began,
        focal_scale=np.nan if fit is None else fit.focal_scale,
        focal_scale_sigma=np.nan if fit is None else fit.focal_scale_sigma,
        warnings=warnings if fit is None else (*warnings, *intrinsics_warnings(fit, prior)),
    )


def _pull(expanded: Expanded, search: Search, covariance: FloatArray) -> FloatArray:
    """Covariance (6, 6) for the pair that pulls the pose most, if it does so unusually: it may be wrong."""
    if np.sum(expanded.match >= 0) < _MIN_PAIRS:
        return np.zeros((6, 6))
    data = pack_rims(search.view, search.index.craters, expanded.match, expanded.sigma)
    N = np.empty((6, 6))
    fit_pose(expanded.gTc.copy(), data, search.prior, search.weight, N)
    shifts, _, expected = shifts_without(expanded.gTc, data, N)
    excess = np.einsum("ka,ab,kb->k", shifts, np.linalg.inv(covariance), shifts) - expected
    most = shifts[np.argmax(excess)]
    return np.outer(most, most) * (excess.max() > _MOST_EXCESS)


def _unknown_intrinsics(
    expanded: Expanded, search: Search, covariance: FloatArray, prior: IntrinsicsPrior
) -> IntrinsicsFit:
    """Fit the intrinsics too: moves the pose and enlarges the covariance (6, 6) in place."""
    view, craters = search.view, search.index.craters
    matched = np.flatnonzero(expanded.match >= 0)
    rows = expanded.match[matched]
    scale = np.array([shape_scale(view, int(i), expanded.sigma) for i in matched])
    sigma = np.column_stack([np.full((len(matched), 2), expanded.sigma[0]), *(scale[:, None],) * 3])
    variance = (sigma / view.precision[matched]) ** 2
    S = np.einsum("ni,ij->nij", variance, np.eye(5))
    S[~view.traced[matched]] += _UNKNOWN_SHAPE
    rims = MatchedRims(
        tuple(map(str, rows)), craters.centres[rows], craters.axes[rows], view.charts[matched],
        S,
    )  # fmt: skip
    known = search.limits.attitude
    attitude = KnownAttitude(known, search.sigma_rad) if len(known) else None
    fit = fit_intrinsics(ResectionProblem(rims, attitude=attitude), expanded.gTc, prior)
    covariance += fit.effect @ fit.unknowns_covariance @ fit.effect.T
    screw(expanded.gTc, fit.effect @ fit.unknowns)
    return replace(
        fit,
        focal_scale_sigma=_INTRINSICS_SPREAD * fit.focal_scale_sigma,
        principal_covariance_px2=_INTRINSICS_SPREAD**2 * fit.principal_covariance_px2,
    )
