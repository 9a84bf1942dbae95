"""Maximum a posteriori poses from matched rims, and the matches that a pose implies."""

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels import conic
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import move, prior_terms, solve
from factors.kernels.sun import sun_tilt, wrap

# Gate of a match's squared distance: the 99.97 % quantile of chi-square with 5 degrees of freedom.
PAIR_GATE = 23.0
# Gauss-Newton iterations: quadratic convergence from a few sigmas.
_ITERATIONS = 4


@njit(cache=True, error_model="numpy")
def map_poses(
    prior: FloatArray, W: FloatArray, start: FloatArray, bTc: FloatArray, centres: FloatArray,
    axes: FloatArray, gains: FloatArray, charts: FloatArray, weights: FloatArray, tilts: FloatArray,
    tilt_weight: float, crater: IntArray, rim: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Maximum a posteriori poses from rims, sun and prior by Gauss-Newton.

    Parameters
    ----------
    prior, W : ndarray, shape (4, 4) and (6, 6)
        Prior pose gTb and the inverse of its covariance.
    start : ndarray, shape (h, 4, 4)
        Poses gTb at which to begin.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, gains : ndarray, shapes (m, 3), (m, 2, 3), (m, 3)
        The craters: rims in g, m; directions in g in which their walls are darkest.
    charts, weights, tilts : ndarray, shapes (n, 5), (n, 5, 5), (n,)
        The rims: ellipse charts, inverses of their covariances, directions in the image in which their
        walls are darkest, rad.
    tilt_weight : float
        Inverse variance of a tilt, 1/rad^2, divided among a pose's rims, as their errors are common; 0 for
        none.
    crater, rim : ndarray of int, shape (h, k)
        The matches that each pose rests on.

    Returns
    -------
    gTb : ndarray, shape (h, 4, 4)
    information : ndarray, shape (h, 6, 6)
        For the right twist at the last linearisation.
    cost : ndarray, shape (h,)
        Squared Mahalanobis norm of all residuals; inf when a rim is out of sight.
    """
    poses = start.copy()
    informations = np.empty((start.shape[0], 6, 6))
    costs = np.empty(start.shape[0])
    p, c, d = np.empty(3), np.empty((2, 3)), np.empty(3)
    y, J, H, T = np.empty(5), np.empty((5, 6)), np.empty((5, 6)), np.empty((1, 6))
    g, delta = np.empty(6), np.empty(6)
    each = tilt_weight / crater.shape[1]
    for h in range(start.shape[0]):
        pose, N = poses[h], informations[h]
        for iteration in range(_ITERATIONS + 1):
            cost = prior_terms(prior, W, pose, N, g)
            R, P = conic.camera_pose(pose, bTc)
            for k in range(crater.shape[1]):
                m, i = crater[h, k], rim[h, k]
                conic.rim_in_camera(R, P, centres[m], axes[m], p, c)
                if not conic.chart_and_jacobian(p, c, y, J):
                    cost = np.inf
                    break
                conic.body_columns(J, bTc, H)
                for a in range(5):
                    for b in range(5):
                        w, r = weights[i, a, b], y[b] - charts[i, b]
                        cost += w * r * (y[a] - charts[i, a])
                        for s in range(6):
                            g[s] += H[a, s] * w * r
                            for t in range(6):
                                N[s, t] += H[a, s] * w * H[b, t]
                if not tilt_weight > 0.0:
                    continue
                for s in range(3):
                    d[s] = gains[m, s]
                tilt, strength = sun_tilt(pose, bTc, d, charts[i, 0], charts[i, 1], T)
                if strength > 0.0:
                    off = wrap(tilt - tilts[i])
                    cost += each * off * off
                    for s in range(6):
                        g[s] += each * T[0, s] * off
                        for t in range(6):
                            N[s, t] += each * T[0, s] * T[0, t]
            costs[h] = cost
            if iteration == _ITERATIONS or cost == np.inf:
                break
            solve(N, g, delta)
            for s in range(6):
                delta[s] = -delta[s]
            move(pose, delta)
    return poses, informations, costs


@njit(cache=True, error_model="numpy")
def distances2(
    gTb: FloatArray, covariance: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray,
    charts: FloatArray, rim_covariance: FloatArray, gate: float, reach: FloatArray,
) -> FloatArray:  # fmt: skip
    """Squared Mahalanobis distances of rims from the charts that a pose predicts of craters.

    Parameters
    ----------
    gTb, covariance : ndarray, shapes (4, 4) and (6, 6)
        Pose, and its covariance for the right twist.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes : ndarray, shapes (m, 3), (m, 2, 3)
        Rims of the craters in g, m.
    charts : ndarray, shape (n, 5)
        Ellipse charts of the rims.
    rim_covariance : ndarray, shape (n, 5, 5)
        Covariances of the charts.
    gate : float
        Beyond it the distance is inf.
    reach : ndarray, shape (2,)
        Largest |u|, |v| of a crater's image centre, normalised; craters beyond it are skipped.

    Returns
    -------
    ndarray, shape (n, m)
        Squared distance of every rim from every crater, in sigmas (5 degrees of freedom); inf beyond gate or
        reach.
    """
    count = charts.shape[0]
    out = np.full((count, centres.shape[0]), np.inf)
    R, P = conic.camera_pose(gTb, bTc)
    p, c = np.empty(3), np.empty((2, 3))
    y, J, H = np.empty(5), np.empty((5, 6)), np.empty((5, 6))
    HC, spread, total = np.empty((5, 6)), np.empty((5, 5)), np.empty((5, 5))
    r, x = np.empty(5), np.empty(5)
    for m in range(centres.shape[0]):
        conic.rim_in_camera(R, P, centres[m], axes[m], p, c)
        if not conic.chart(p, c, y) or np.abs(y[0]) > reach[0] or np.abs(y[1]) > reach[1]:
            continue
        conic.chart_and_jacobian(p, c, y, J)
        conic.body_columns(J, bTc, H)
        for a in range(5):
            for t in range(6):
                HC[a, t] = 0.0
                for s in range(6):
                    HC[a, t] += H[a, s] * covariance[s, t]
            for b in range(5):
                spread[a, b] = 0.0
                for t in range(6):
                    spread[a, b] += HC[a, t] * H[b, t]
        for i in range(count):
            # Cheap bounds first: each component by itself.
            near = True
            for a in range(5):
                r[a] = charts[i, a] - y[a]
                near = near and r[a] * r[a] < gate * (spread[a, a] + rim_covariance[i, a, a])
            if not near:
                continue
            for a in range(5):
                for b in range(5):
                    total[a, b] = spread[a, b] + rim_covariance[i, a, b]
            solve(total, r, x)
            d2 = 0.0
            for a in range(5):
                d2 += r[a] * x[a]
            if d2 < gate:
                out[i, m] = d2
    return out


@njit(cache=True, error_model="numpy")
def nearest(
    gTb: FloatArray, covariance: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray,
    charts: FloatArray, rim_covariance: FloatArray, reach: FloatArray,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Match each rim with the crater that a pose puts nearest to it.

    Parameters
    ----------
    gTb, covariance : ndarray, shapes (4, 4) and (6, 6)
        Pose, and its covariance for the right twist.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes : ndarray, shapes (m, 3), (m, 2, 3)
        Rims of the craters in g, m.
    charts : ndarray, shape (n, 5)
        Ellipse charts of the rims.
    rim_covariance : ndarray, shape (n, 5, 5)
        Covariances of the charts.
    reach : ndarray, shape (2,)
        Largest |u|, |v| of a crater's image centre, normalised; craters beyond it are skipped.

    Returns
    -------
    crater : ndarray of int, shape (n,)
        -1 when none passes the gate, or when another rim is nearer to the same crater.
    distance2 : ndarray, shape (n,)
        Squared Mahalanobis distance of the charts, in squared sigmas; `PAIR_GATE` without a match.
    """
    count = charts.shape[0]
    crater = np.full(count, -1, np.int64)
    distance2 = np.full(count, PAIR_GATE)
    all2 = distances2(gTb, covariance, bTc, centres, axes, charts, rim_covariance, PAIR_GATE, reach)
    for i in range(count):
        for m in range(centres.shape[0]):
            if all2[i, m] < distance2[i]:
                crater[i], distance2[i] = m, all2[i, m]
    # Of two rims with one crater, the nearer keeps it.
    for i in range(count):
        for j in range(i):
            if crater[i] >= 0 and crater[i] == crater[j]:
                farther = i if distance2[i] >= distance2[j] else j
                crater[farther], distance2[farther] = -1, PAIR_GATE
    return crater, distance2


@njit(cache=True, error_model="numpy")
def support(
    poses: FloatArray, covariance: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray,
    charts: FloatArray, rim_covariance: FloatArray, reach: FloatArray,
) -> IntArray:  # fmt: skip
    """Count the rims that `nearest` matches, for each of several poses.

    Parameters
    ----------
    poses, covariance : ndarray, shapes (h, 4, 4) and (h, 6, 6)
        Poses gTb, and their covariances for the right twist.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes : ndarray, shapes (m, 3), (m, 2, 3)
        Rims of the craters in g, m.
    charts : ndarray, shape (n, 5)
        Ellipse charts of the rims.
    rim_covariance : ndarray, shape (n, 5, 5)
        Covariances of the charts.
    reach : ndarray, shape (2,)
        Largest |u|, |v| of a crater's image centre, normalised; craters beyond it are skipped.

    Returns
    -------
    ndarray of int, shape (h,)
    """
    out = np.zeros(poses.shape[0], np.int64)
    for k in range(poses.shape[0]):
        crater, _ = nearest(poses[k], covariance[k], bTc, centres, axes, charts, rim_covariance, reach)
        for i in range(crater.shape[0]):
            if crater[i] >= 0:
                out[k] += 1
    return out
