"""Final pose and covariance, averaged over the noise of the rims, which is known only roughly.

A few rims determine neither their noise well nor whether errors of the axes are constant in pixels or
proportional to the axes. Each considered noise gives a pose with a covariance and has a posterior probability
(restricted likelihood: the degrees of freedom that the pose takes are accounted for). The result is the
mixture's mean and covariance.
"""

import numpy as np

from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.noise import (
    AXIS_LEVELS,
    AXIS_SHARES,
    CENTRE_SIGMA_RANGE_PX,
    log_axis_prior,
    shape_scale,
)
from craternav_fg.matching.identify.pose_fit import fit_pose, pack_rims
from craternav_fg.matching.identify.view import AXIS_SIGMA_PX, View
from factors.arrays import FloatArray, IntArray
from factors.kernels import packed
from factors.kernels.gauss_newton import prior_terms, screw

# Noise levels of the centres that are considered, px: the range in steps of the root of 2.
_CENTRE_LEVELS_PX = CENTRE_SIGMA_RANGE_PX[0] * 2.0 ** np.arange(
    0.0, np.log2(CENTRE_SIGMA_RANGE_PX[1] / CENTRE_SIGMA_RANGE_PX[0]) + 0.5, 0.5
)


def refine(
    view: View, craters: Craters, prior: FloatArray, weight: FloatArray, gTc: FloatArray, match: IntArray,
    sigma: FloatArray,
) -> FloatArray:  # fmt: skip
    """Refine a pose and compute its covariance.

    Parameters
    ----------
    view : View
    craters : Craters
    prior, weight : ndarray, shapes (4, 4), (6, 6)
        Known attitude as pose and information; without one, `weight` is zero.
    gTc : ndarray, shape (4, 4)
        Changed: the pose of the camera.
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    sigma : ndarray, shape (3,)
        Noise, see `noise`. Changed: its posterior geometric mean.

    Returns
    -------
    ndarray, shape (6, 6)
        Covariance for the camera's right twist [w, rho], rad and m.
    """
    data = pack_rims(view, craters, match, sigma)
    fit_pose(gTc, data, prior, weight, np.empty((6, 6)))
    matched = np.flatnonzero(match >= 0)
    out = np.empty((7, 5 * len(matched)))
    packed.shape_residuals(gTc, data, True, out)
    # The Huber weights stay those of the most probable noise.
    rows = out.reshape(7, len(matched), 5)
    shape_sigma = np.array([shape_scale(view, int(i), sigma) for i in matched])
    places = rows[:, :, :2].reshape(7, -1) * sigma[0]
    shapes = rows[:, :, 2:] * shape_sigma[None, :, None]
    known = np.zeros((7, 7))
    if weight[0, 0] > 0.0:
        N, g = np.empty((6, 6)), np.empty(6)
        known[6, 6] = prior_terms(prior, weight, gTc, N, g)
        known[:6, :6], known[:6, 6] = N, g
        known[6, :6] = known[:6, 6]
    sizes, shares, levels = (
        grid.ravel() for grid in np.meshgrid(AXIS_LEVELS, AXIS_SHARES, _CENTRE_LEVELS_PX, indexing="ij")
    )
    # Sums of squares per noise of the axes; the noise of the centres is a factor.
    scale2 = AXIS_LEVELS[:, None, None] ** 2 + (
        AXIS_SHARES[:, None] / AXIS_SIGMA_PX * view.radius_px[matched]
    ) ** 2  # fmt: skip
    each = np.einsum("akr,bkr->kab", shapes, shapes).reshape(len(matched), 49)
    of_shapes = (1.0 / scale2).reshape(-1, len(matched)) @ each
    squares = of_shapes.reshape(-1, 1, 7, 7) + known
    squares = squares + (places @ places.T) / _CENTRE_LEVELS_PX[:, None, None] ** 2
    squares = squares.reshape(-1, 7, 7)
    N, g = squares[:, :6, :6], squares[:, :6, 6]
    covariances = np.linalg.inv(N)
    steps = -np.einsum("kab,kb->ka", covariances, g)
    shown = np.where(view.traced[matched], 3.0, 1.0)
    log_scales = (np.log(scale2) @ shown).ravel().repeat(len(_CENTRE_LEVELS_PX))
    log = -0.5 * (squares[:, 6, 6] + np.einsum("ka,ka->k", g, steps) + np.linalg.slogdet(N)[1])
    log -= 2.0 * len(matched) * np.log(levels) + 0.5 * log_scales
    log += np.array([log_axis_prior(size, level) for size, level in zip(sizes, levels, strict=True)])
    share = np.exp(log - log.max())
    share /= share.sum()
    step = share @ steps
    apart = steps - step
    covariance = np.tensordot(share, covariances, 1) + np.einsum("k,ka,kb->ab", share, apart, apart)
    screw(gTc, step)
    sigma[:] = [np.exp(share @ np.log(values)) for values in (levels, sizes, shares)]
    return np.asarray(covariance)
