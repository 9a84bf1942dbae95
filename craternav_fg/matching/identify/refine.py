"""The pose of an answer with its covariance, averaged over what the noise may be.

Few rims tell their noise badly, and not whether errors of axes are of a size in pixels or a share of the
axes. Each noise gives a pose with a covariance, and is as probable as the rims' errors are with it, the
freedom counted that the pose takes (restricted likelihood); the answer is the mean over all of them.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.expand import STEPS, frame_data, refine
from craternav_fg.matching.identify.noise import AXIS_LEVELS, AXIS_SHARES, SIGMA_RANGE, log_alike, shape_scale
from craternav_fg.matching.identify.view import AXIS_PX, View
from factors.kernels import packed
from factors.kernels.gauss_newton import prior_terms, screw

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_CENTRE_LEVELS = SIGMA_RANGE[0] * 2.0 ** np.arange(0.0, np.log2(SIGMA_RANGE[1] / SIGMA_RANGE[0]) + 0.5, 0.5)


def settle(
    view: View, craters: Craters, prior: FloatArray, weight: FloatArray, gTc: FloatArray,
    match: IntArray, sigma: FloatArray,
) -> FloatArray:  # fmt: skip
    """Give the covariance (6, 6) of a pose, for its right twist; pose and noise are put right, in place.

    Parameters
    ----------
    view : View
    craters : Craters
    prior, weight, gTc, match, sigma
        As in `expand.expand_inliers`.
    """
    refine(gTc, frame_data(view, craters, match, sigma), prior, weight, STEPS, np.empty((6, 6)))
    matched = np.flatnonzero(match >= 0)
    out = np.empty((7, 5 * len(matched)))
    packed.shape_residuals(gTc, frame_data(view, craters, match, sigma), True, out)
    # Rims that contradict the others keep the weight that they have with the likeliest noise.
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
        grid.ravel() for grid in np.meshgrid(AXIS_LEVELS, AXIS_SHARES, _CENTRE_LEVELS, indexing="ij")
    )
    # Of each noise of the axes; the centres' enter as a factor.
    scale2 = AXIS_LEVELS[:, None, None] ** 2 + (
        AXIS_SHARES[:, None] / AXIS_PX * view.radius_px[matched]
    ) ** 2  # fmt: skip
    each = np.einsum("akr,bkr->kab", shapes, shapes).reshape(len(matched), 49)
    of_shapes = (1.0 / scale2).reshape(-1, len(matched)) @ each
    squares = of_shapes.reshape(-1, 1, 7, 7) + known
    squares = squares + (places @ places.T) / _CENTRE_LEVELS[:, None, None] ** 2
    squares = squares.reshape(-1, 7, 7)
    N, g = squares[:, :6, :6], squares[:, :6, 6]
    covariances = np.linalg.inv(N)
    steps = -np.einsum("kab,kb->ka", covariances, g)
    log_scales = np.log(scale2).sum(axis=-1).ravel().repeat(len(_CENTRE_LEVELS))
    log = -0.5 * (squares[:, 6, 6] + np.einsum("ka,ka->k", g, steps) + np.linalg.slogdet(N)[1])
    log -= 2.0 * len(matched) * np.log(levels) + 1.5 * log_scales
    log += np.array([log_alike(size, level) for size, level in zip(sizes, levels, strict=True)])
    share = np.exp(log - log.max())
    share /= share.sum()
    step = share @ steps
    apart = steps - step
    covariance = np.tensordot(share, covariances, 1) + np.einsum("k,ka,kb->ab", share, apart, apart)
    screw(gTc, step)
    sigma[:] = [np.exp(share @ np.log(values)) for values in (levels, sizes, shares)]
    return np.asarray(covariance)
