"""Conic-shape residual, eq. (19): zeros, derivatives, and its relation to eq. (22)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factors.kernels import conic, shape
from tests.factors.conics import conic_to_chart

BODY_TO_CAMERA = np.eye(4)
BODY_TO_CAMERA[:3, :3] = Rotation.from_euler("zyx", [0.4, -0.3, 2.8]).as_matrix()
BODY_TO_CAMERA[:3, 3] = [1.2, -0.7, 0.4]
RX180 = np.diag([1.0, -1.0, -1.0])
RZ180 = np.diag([-1.0, -1.0, 1.0])


def view(rng, tilt_rad, range_m, axes_m):
    """Body pose, crater (centre, gRl, semi-axes) and its exact conic, from `tilt_rad` off the normal."""
    gRl = Rotation.random(random_state=rng).as_matrix()
    gL = rng.normal(size=3) * 1e6
    azimuth = rng.uniform(0, 2 * np.pi)
    direction = np.array(
        [np.sin(tilt_rad) * np.cos(azimuth), np.sin(tilt_rad) * np.sin(azimuth), np.cos(tilt_rad)]
    )
    gPc = gL + range_m * gRl @ direction
    # Optical axis a little off the crater, any turn about it.
    z = gRl @ -direction
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    gRc = (
        np.stack([x, np.cross(z, x), z], axis=-1) @ Rotation.from_rotvec(0.1 * rng.normal(size=3)).as_matrix()
    )
    gTc = np.eye(4)
    gTc[:3, :3], gTc[:3, 3] = gRc, gPc
    gTb = gTc @ np.linalg.inv(BODY_TO_CAMERA)
    return gTb, gTc, gL, gRl, np.asarray(axes_m), rim_conic(gTc, gL, gRl, axes_m)


def rim_conic(gTc, gL, gRl, axes_m):
    """Conic through the projected rim points, by a null space: independent of the library."""
    t = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    points = gL + (gRl[:, :2] @ (np.asarray(axes_m)[:, None] * [np.cos(t), np.sin(t)])).T
    X = (points - gTc[:3, 3]) @ gTc[:3, :3]
    u, v = X[:, 0] / X[:, 2], X[:, 1] / X[:, 2]
    # Conditioned: fit in shifted and scaled coordinates, then take the conic back.
    c, s = np.array([u.mean(), v.mean()]), np.std(u)
    a, b = (u - c[0]) / s, (v - c[1]) / s
    q = np.linalg.svd(np.stack([a * a, a * b, b * b, a, b, np.ones_like(a)], axis=-1))[2][-1]
    Q = np.array([[q[0], q[1] / 2, q[3] / 2], [q[1] / 2, q[2], q[4] / 2], [q[3] / 2, q[4] / 2, q[5]]])
    N = np.array([[1 / s, 0, -c[0] / s], [0, 1 / s, -c[1] / s], [0, 0, 1]])
    Q = N.T @ Q @ N
    q = np.array([Q[0, 0], 2 * Q[0, 1], Q[1, 1], 2 * Q[0, 2], 2 * Q[1, 2], Q[2, 2]])
    return q / np.linalg.norm(q)


def batch(gTb, gL, gRl, axes, q):
    return shape.shape_jacobian(gTb, BODY_TO_CAMERA, gL[None], gRl[None], axes[None], q[None])


def local(gTc, gL, gRl):
    """cRl and T of a view."""
    return gTc[:3, :3].T @ gRl, gRl.T @ (gTc[:3, 3] - gL)


def at(R, T, axes, q):
    h, H, D = np.empty(5), np.empty((5, 6)), np.empty((5, 6))
    shape.shape(np.ascontiguousarray(R), T, *axes, q, h, H, D)
    return h, D


VIEWS = [
    pytest.param(0.4, 50e3, (2500.0, 1500.0), id="ordinary"),
    pytest.param(1.2, 20e3, (2000.0, 1900.0), id="oblique"),
    pytest.param(1e-4, 30e3, (2000.0, 1300.0), id="head-on"),
    pytest.param(1e-4, 30e3, (2000.0, 2000.0), id="head-on-circle"),
    pytest.param(0.5, 100e3, (500.0, 499.999), id="small-nearly-circular"),
]


@pytest.mark.parametrize(("tilt", "range_m", "axes"), VIEWS)
def test_vanishes_at_the_four_poses_and_nowhere_near(tilt, range_m, axes):
    rng = np.random.default_rng(1)
    for _ in range(20):
        _, gTc, gL, gRl, axes_m, q = view(rng, tilt, range_m, axes)
        R, T = local(gTc, gL, gRl)
        _, D = at(R, T, axes_m, q)
        size = np.linalg.norm(D, axis=1)
        zeros = [
            (R, T),
            (R, -T),
            (R @ RZ180, RZ180 @ T),
            (R @ RX180, T * [-1.0, 1.0, 1.0]),
            (R @ RX180, RX180 @ T),
        ]
        for R0, T0 in zeros:
            np.testing.assert_allclose(at(R0, T0, axes_m, q)[0] / size, 0.0, atol=1e-9)
        # A tenth of a rim radius aside, and a degree turned, are no zeros.
        aside = at(R, T + 0.1 * axes_m[1] * np.array([1.0, 0.0, 0.0]), axes_m, q)[0]
        turned = at(R @ Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix(), T, axes_m, q)[0]
        assert np.abs(aside / size).max() > 1e-5
        assert np.abs(turned / size).max() > 1e-5


def test_only_the_true_pose_and_its_half_turn_are_in_front():
    rng = np.random.default_rng(2)
    for _ in range(20):
        gTb, gTc, gL, gRl, axes_m, q = view(rng, 0.5, 40e3, (2200.0, 1400.0))
        assert batch(gTb, gL, gRl, axes_m, q)[3][0]
        R, T = local(gTc, gL, gRl)
        verdicts = []
        for R0, T0 in [
            (R @ RZ180, RZ180 @ T),
            (R, -T),
            (R @ RX180, T * [-1.0, 1.0, 1.0]),
            (R @ RX180, RX180 @ T),
        ]:
            twin = np.eye(4)
            twin[:3, :3] = gRl @ R0.T
            twin[:3, 3] = gL + gRl @ T0
            h, _, _, in_front = batch(twin @ np.linalg.inv(BODY_TO_CAMERA), gL, gRl, axes_m, q)
            assert np.abs(h[0] / np.linalg.norm(at(R0, T0, axes_m, q)[1], axis=1)).max() < 1e-9
            verdicts.append(bool(in_front[0]))
        assert verdicts == [True, False, False, False]


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize(("tilt", "range_m", "axes"), VIEWS)
def test_derivatives_agree_with_central_differences(tilt, range_m, axes, exact):
    rng = np.random.default_rng(3)
    for _ in range(10):
        gTb, _, gL, gRl, axes_m, q = view(rng, tilt, range_m, axes)
        if not exact:
            q = q + 0.01 * rng.normal(size=6) * np.abs(q)
        _, H, D, _ = batch(gTb, gL, gRl, axes_m, q)

        def body(d, gTb=gTb, gL=gL, gRl=gRl, axes_m=axes_m, q=q):
            T = gTb.copy()
            T[:3, :3] = gTb[:3, :3] @ Rotation.from_rotvec(d[:3]).as_matrix()
            T[:3, 3] = gTb[:3, 3] + gTb[:3, :3] @ d[3:]
            return batch(T, gL, gRl, axes_m, q)[0][0]

        def coefficients(d, gTb=gTb, gL=gL, gRl=gRl, axes_m=axes_m, q=q):
            return batch(gTb, gL, gRl, axes_m, q + d)[0][0]

        steps = np.repeat([1e-3, 1e-3 * range_m], 3)
        numeric = richardson(body, steps)
        # Columns in comparable units; each row of (19) has its own.
        relative = (numeric - H[0]) * steps
        size = np.abs(H[0] * steps).max(axis=1, keepdims=True)
        np.testing.assert_allclose(relative / size, 0.0, atol=1e-6)
        np.testing.assert_allclose(
            richardson(coefficients, np.full(6, 1e-2)), D[0], rtol=1e-6, atol=1e-9 * np.abs(D[0]).max()
        )


def richardson(f, steps):
    def central(i, h):
        d = h * np.eye(len(steps))[i]
        return (f(d) - f(-d)) / (2 * h)

    return np.stack([(4 * central(i, h / 2) - central(i, h)) / 3 for i, h in enumerate(steps)], axis=-1)


def test_rows_two_to_four_contain_the_line_of_sight_equations():
    rng = np.random.default_rng(4)
    for _ in range(50):
        _, gTc, gL, gRl, axes_m, _ = view(rng, rng.uniform(0, 1.2), rng.uniform(1e4, 1e5), (2100.0, 1200.0))
        R, T = local(gTc, gL, gRl)
        # Any conic: an identity, not only at the zero.
        q = rng.normal(size=6)
        Q = np.array([[q[0], q[1] / 2, q[3] / 2], [q[1] / 2, q[2], q[4] / 2], [q[3] / 2, q[4] / 2, q[5]]])
        h, _ = at(R, T, axes_m, q)
        los = R.T @ Q @ R @ T  # eq. (22): its first two components vanish
        np.testing.assert_allclose([h[2] + T[1] * h[1], h[3] + T[0] * h[1]], los[:2], rtol=1e-9, atol=1e-6)


def test_whitened_it_carries_the_information_of_the_chart():
    # EQUATIONS: whitened by J_q S_q J_q' at the pose, (19) equals a constant-noise residual in q. In
    # information: H' (D S D')^-1 H of (19) and J' S_y^-1 J of the chart agree at the true pose.
    rng = np.random.default_rng(6)
    for _ in range(20):
        gTb, _, gL, gRl, axes_m, q = view(rng, 0.6, 30e3, (2300.0, 1300.0))
        gTc = gTb @ BODY_TO_CAMERA
        y = conic_to_chart(q)
        S_y = np.diag([1e-4, 1.2e-4, 3e-3, 4e-3, 3e-3]) ** 2
        axes = (gRl[:, :2] * axes_m).T
        predicted, J, _ = conic.chart_jacobian(
            gTb, BODY_TO_CAMERA, gL[None], np.ascontiguousarray(axes)[None]
        )
        np.testing.assert_allclose(predicted[0], y, atol=1e-7)
        A = conic.chart_to_conic_jacobian(y)
        _, H, D, _ = batch(gTb, gL, gRl, axes_m, conic.chart_to_conic(y))
        shape_noise = D[0] @ A @ S_y @ A.T @ D[0].T
        s = np.sqrt(np.diag(shape_noise))
        info_shape = (H[0] / s[:, None]).T @ np.linalg.solve(shape_noise / np.outer(s, s), H[0] / s[:, None])
        info_chart = J[0].T @ np.linalg.solve(S_y, J[0])
        units = np.repeat([1.0, np.linalg.norm(gTc[:3, 3] - gL)], 3)
        difference = (info_shape - info_chart) * np.outer(units, units)
        assert np.abs(difference).max() < 1e-6 * np.abs(info_chart * np.outer(units, units)).max()
