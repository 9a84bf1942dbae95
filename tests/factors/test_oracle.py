"""Jacobians of every image kernel against symbolic derivatives.

The expressions are built from the geometry, not from the kernels' formulas: a rim is the image of the unit
circle under the homography [c1 c2 p], and its conic, chart and distances follow from that.
"""

from collections.abc import Callable
from functools import cache

import gtsam
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from factors.kernels import conic, implicit, los, packed, rim, robust, shape, stacked, sun
from tests.factors.conftest import View, make_view, rim_points

EYE = np.eye(4)
TWIST = sp.symbols("w:3 r:3")


def symbols(name: str, count: int) -> list[sp.Symbol]:
    return list(sp.symbols(f"{name}:{count}"))


P_SYMBOLS, C1_SYMBOLS, C2_SYMBOLS = symbols("p", 3), symbols("c", 3), symbols("d", 3)
RIM = [*P_SYMBOLS, *C1_SYMBOLS, *C2_SYMBOLS]


def skew(w: list[sp.Expr]) -> sp.Matrix:
    return sp.Matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def turned(direction: list[sp.Symbol]) -> sp.Matrix:
    """A fixed direction in the camera that is turned by exp(w), to first order."""
    return (sp.eye(3) - skew(TWIST[:3])) * sp.Matrix(direction)


def moved(point: list[sp.Symbol]) -> sp.Matrix:
    """A fixed point in the camera that is moved by rho, then turned."""
    return (sp.eye(3) - skew(TWIST[:3])) * (sp.Matrix(point) - sp.Matrix(TWIST[3:]))


def rim_motion() -> sp.Matrix:
    """Jacobian (9, 6) of a rim's centre and semi-axes in the camera's twist."""
    return sp.Matrix.vstack(moved(P_SYMBOLS), turned(C1_SYMBOLS), turned(C2_SYMBOLS)).jacobian(TWIST)


def rim_conic() -> sp.Matrix:
    """Conic matrix, up to scale, by the homography from the unit circle."""
    H = sp.Matrix.hstack(sp.Matrix(C1_SYMBOLS), sp.Matrix(C2_SYMBOLS), sp.Matrix(P_SYMBOLS)).adjugate()
    return H.T * sp.diag(1, 1, -1) * H


def coefficients(Q: sp.Matrix) -> sp.Matrix:
    return sp.Matrix([Q[0, 0], 2 * Q[0, 1], Q[1, 1], 2 * Q[0, 2], 2 * Q[1, 2], Q[2, 2]])


def matrix_of(q: list[sp.Symbol]) -> sp.Matrix:
    A, B, C, D, E, F = q
    return sp.Matrix([[A, B / 2, D / 2], [B / 2, C, E / 2], [D / 2, E / 2, F]])


def centre_and_spread(Q: sp.Matrix) -> tuple[sp.Matrix, sp.Matrix]:
    """Centre m and S of (u - m)' S^-1 (u - m) = 1."""
    M = Q[:2, :2]
    inverse = M.adjugate() / (M[0, 0] * M[1, 1] - M[0, 1] ** 2)
    m = -inverse * Q[:2, 2]
    k = (Q[:2, 2].T * inverse * Q[:2, 2])[0] - Q[2, 2]
    return m, k * inverse


def chart_of(Q: sp.Matrix) -> sp.Matrix:
    m, S = centre_and_spread(Q)
    return sp.Matrix(
        [m[0], m[1], sp.log(S[0, 0]) / 2, S[0, 1] / S[0, 0], sp.log(S[1, 1] - S[0, 1] ** 2 / S[0, 0]) / 2]
    )


@cache
def function(name: str) -> Callable[..., np.ndarray]:
    """Residual or Jacobian as a function of numbers, differentiated here and now."""
    q, n, u, R, T = symbols("q", 6), symbols("n", 3), symbols("u", 2), symbols("R", 9), symbols("T", 3)
    a, b = sp.symbols("a b")
    if name == "motion":
        arguments, expression = [RIM, TWIST], rim_motion()
    elif name == "chart":
        arguments, expression = [q], chart_of(matrix_of(q)).jacobian(q)
    elif name == "conic":
        arguments, expression = [RIM], coefficients(rim_conic())
    elif name == "conic's change":
        arguments, expression = [RIM], coefficients(rim_conic()).jacobian(RIM)
    elif name == "conic of chart":
        y = symbols("y", 5)
        S = sp.Matrix([[1, y[3]], [y[3], y[3] ** 2]]) * sp.exp(2 * y[2]) + sp.diag(0, sp.exp(2 * y[4]))
        m = sp.Matrix(y[:2])
        M = S.adjugate() / sp.exp(2 * y[2] + 2 * y[4])
        Q = sp.Matrix.vstack(sp.Matrix.hstack(M, -M * m), sp.Matrix.hstack(-m.T * M, m.T * M * m - sp.eye(1)))
        c = coefficients(Q)
        arguments, expression = [y], (c / sp.sqrt((c.T * c)[0])).jacobian(y)
    elif name == "distance":
        # On the conic's own level function g = x'Qx: 1 + g / k is the squared radius, k that of the centre.
        x = sp.Matrix([*u, 1])
        level = (x.T * matrix_of(q) * x)[0]
        A, B, C, D, E, F = q
        k = (A * E**2 - B * D * E + C * D**2) / (4 * A * C - B**2) - F
        f = sp.sqrt(1 + level / k) - 1
        distance = f / sp.sqrt(f.diff(u[0]) ** 2 + f.diff(u[1]) ** 2)
        arguments, expression = [q, u], sp.Matrix([distance]).jacobian(q)
    elif name == "line of sight":
        v = -4 * matrix_of(q).adjugate() * sp.Matrix(n)
        arguments, expression = [q, n], (v / sp.sqrt((v.T * v)[0])).jacobian([*q, *n])
    elif name == "direction":
        p = sp.Matrix(P_SYMBOLS)
        arguments, expression = [P_SYMBOLS], (p / sp.sqrt((p.T * p)[0])).jacobian(P_SYMBOLS)
    elif name == "printed (19)":
        W, rho = TWIST[:3], TWIST[3:]
        cRl = (sp.eye(3) - skew(W)) * sp.Matrix(3, 3, R)
        lT = sp.Matrix(T) + sp.Matrix(3, 3, R).T * sp.Matrix(rho)
        N = cRl.T * matrix_of(q) * cRl
        h = sp.Matrix(
            [
                a**2 * N[0, 0] - b**2 * N[1, 1],
                N[0, 1],
                lT[2] * N[0, 2] + lT[0] * N[0, 0],
                lT[2] * N[1, 2] + lT[1] * N[1, 1],
                (a**2 - lT[0] ** 2) * N[0, 0] - lT[1] ** 2 * N[1, 1] + lT[2] ** 2 * N[2, 2],
            ]
        )
        J = h.jacobian([*TWIST, *q]).subs(dict.fromkeys(TWIST, 0))
        arguments, expression = [R, T, q, a, b], J
    else:
        s = turned(n)
        tilt = sp.atan2(s[1] - u[1] * s[2], s[0] - u[0] * s[2])
        arguments, expression = [n, u], sp.Matrix([tilt]).jacobian(TWIST).subs(dict.fromkeys(TWIST, 0))
    return sp.lambdify(arguments, expression, "numpy", cse=True)


def rims(view: View) -> list[tuple[np.ndarray, np.ndarray]]:
    """Every rim's centre and semi-axes in the camera, flat (9,), and their motion (9, 6)."""
    gTc = view.gTb @ view.bTc
    out = []
    for L, axes in zip(view.catalog.centres, view.catalog.axes, strict=True):
        flat = np.concatenate([gTc[:3, :3].T @ (L - gTc[:3, 3]), *(axes @ gTc[:3, :3])])
        out.append((flat, function("motion")(flat, np.zeros(6))))
    return out


def camera_columns(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the camera as a body with the identity as mounting, and scales of the twist's columns.

    Kernels that only factors call are given it column-major, as GTSAM's matrices are: each order is compiled.
    """
    gTc = view.gTb @ view.bTc
    distance = np.linalg.norm(view.catalog.centres[0] - gTc[:3, 3])
    return np.ascontiguousarray(gTc), np.repeat([1.0, 1.0 / distance], 3)


def assert_same(actual: np.ndarray, expected: np.ndarray, scale: np.ndarray) -> None:
    """Equal to 1e-8 of each row, its columns in comparable units."""
    rows = np.abs(expected / scale).max(axis=-1, keepdims=True)
    assert_allclose(actual / scale / rows, expected / scale / rows, atol=1e-8)


def conics(flat: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rim's conic (6,) and its motion (6, 6), scaled to unit size."""
    q = function("conic")(flat).ravel()
    size = np.linalg.norm(q)
    return q / size, function("conic's change")(flat) @ motion / size


@pytest.fixture(params=[(0, 50e3, 20.0), (1, 2e3, 55.0), (2, 100e3, 0.0), (3, 5e3, 75.0)])
def case(request: pytest.FixtureRequest) -> View:
    seed, altitude_m, tilt_deg = request.param
    return make_view(seed, altitude_m=altitude_m, tilt_deg=tilt_deg, circular=tilt_deg == 0.0)


def test_chart(case: View) -> None:
    pose, scale = camera_columns(case)
    c = case.catalog
    _, J, _ = conic.chart_jacobian(pose, EYE, c.centres, c.axes)
    for k, (flat, motion) in enumerate(rims(case)):
        q, dq = conics(flat, motion)
        assert_same(J[k], function("chart")(q) @ dq, scale)


def test_shape_residuals(case: View) -> None:
    pose, scale = camera_columns(case)
    c = case.catalog
    n = len(case.charts)
    W = np.linalg.inv(np.linalg.cholesky(case.covariances))
    out = np.empty((7, 5 * n))
    data = packed.pack(EYE, c.centres, c.axes, case.charts, W, robust.NONE, 1.0)
    assert np.isfinite(packed.shape_residuals(pose, data, True, out))
    J = out[:6].T
    for k, (flat, motion) in enumerate(rims(case)):
        q, dq = conics(flat, motion)
        assert_same(J[5 * k : 5 * k + 5], W[k] @ function("chart")(q) @ dq, scale)


def test_implicit(case: View) -> None:
    pose, scale = camera_columns(case)
    c = case.catalog
    n = len(case.charts)
    rng = np.random.default_rng(0)
    P = rng.normal(size=(n, 5, 6))
    q = np.array([conic.chart_to_conic(y + 0.01 * rng.normal(size=5)) for y in case.charts])
    # The kernel takes for granted that the projection has the measured conic in its kernel.
    P -= (P @ q[:, :, None]) * q[:, None, :]
    e, J = np.empty(5 * n), np.empty((5 * n, 6))
    implicit.implicit_residuals(
        np.asfortranarray(pose), EYE, c.centres, c.axes, q, P, robust.NONE, 1.0, True, e, J
    )
    for k, (flat, motion) in enumerate(rims(case)):
        p, dp = conics(flat, motion)
        dot = q[k] @ p
        block = slice(5 * k, 5 * k + 5)
        assert_allclose(e[block], P[k] @ p / dot, atol=1e-9)
        assert_same(J[block], P[k] @ (dp / dot - np.outer(p, q[k] @ dp) / dot**2), scale)


def test_conic_of_chart(case: View) -> None:
    for y in case.charts:
        expected = function("conic of chart")(y)
        assert_allclose(conic.chart_to_conic_jacobian(y), expected, atol=1e-9 * np.abs(expected).max())


def test_rim_points(case: View) -> None:
    pose, scale = camera_columns(case)
    c = case.catalog
    angles = np.arange(0.5, 6.0, 0.7)
    n, m = len(case.charts), len(angles)
    rng = np.random.default_rng(0)
    size = np.exp(case.charts[:, 4])
    points = np.concatenate(
        [rim_points(case, k, angles) + 0.3 * size[k] * rng.normal(size=(m, 2)) for k in range(n)]
    )
    e, J = np.empty(n * m), np.empty((n * m, 6))
    offsets = m * np.arange(n + 1)
    sigmas = np.full(n * m, 0.5)
    roots, z = np.empty((n, 5, 0)), np.empty(0)
    rim.rim_residuals(
        pose, EYE, c.centres, c.axes, offsets, points, sigmas, roots, z, robust.NONE, 1.0, True, e, J
    )
    for k, (flat, motion) in enumerate(rims(case)):
        q, dq = conics(flat, motion)
        for i in range(m * k, m * k + m):
            expected = 2.0 * function("distance")(q, points[i]) @ dq
            assert_same(J[i : i + 1], expected, scale)


def test_centre(case: View) -> None:
    pose, scale = camera_columns(case)
    n = len(case.charts)
    W = np.broadcast_to(np.eye(2), (n, 2, 2)).copy()
    e, J = np.empty(2 * n), np.empty((2 * n, 6))
    stacked.centre_residuals(
        np.asfortranarray(pose), EYE, case.catalog.centres, np.zeros((n, 2)), W, robust.NONE, 1.0, True, e, J
    )
    for k, (flat, motion) in enumerate(rims(case)):
        x, y, z = flat[:3]
        # A point at distance is seen in its direction: the image plane is direction / direction_z.
        D = function("direction")(flat[:3])
        d = flat[:3] / np.linalg.norm(flat[:3])
        image = np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]]) / d[2]
        assert_same(J[2 * k : 2 * k + 2], image @ D @ motion[:3], scale)


def test_line_of_sight(case: View) -> None:
    pose, scale = camera_columns(case)
    n = len(case.charts)
    rng = np.random.default_rng(0)
    q = np.array([conic.chart_to_conic(y + 0.01 * rng.normal(size=5)) for y in case.charts])
    bases = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :2] for _ in range(n)])
    W = np.broadcast_to(np.eye(2), (n, 2, 2)).copy()
    e, J = np.empty(2 * n), np.empty((2 * n, 6))
    stacked.los_residuals(
        np.asfortranarray(pose),
        EYE,
        case.catalog.centres,
        case.catalog.normals,
        q,
        bases,
        W,
        robust.NONE,
        1.0,
        True,
        e,
        J,
    )
    for k, (flat, motion) in enumerate(rims(case)):
        n_c = pose[:3, :3].T @ case.catalog.normals[k]
        D = function("line of sight")(q[k], n_c)
        assert_allclose(los.line_of_sight_jacobian(q[k], n_c), D[:, :6], atol=1e-9 * np.abs(D[:, :6]).max())
        dn = np.zeros((3, 6))
        dn[:, :3] = [[0, -n_c[2], n_c[1]], [n_c[2], 0, -n_c[0]], [-n_c[1], n_c[0], 0]]
        expected = bases[k].T @ (function("direction")(flat[:3]) @ motion[:3] - D[:, 6:] @ dn)
        assert_same(J[2 * k : 2 * k + 2], expected, scale)


def test_printed_equation(case: View) -> None:
    pose, scale = camera_columns(case)
    c = case.catalog
    q = np.array([conic.chart_to_conic(y + 0.01) for y in case.charts])
    semi_axes = np.stack([c.semi_major_m, c.semi_minor_m], axis=-1)
    _, H, D, _ = shape.shape_jacobian(pose, EYE, c.centres, c.gRl, semi_axes, q)
    for k in range(len(q)):
        R = pose[:3, :3].T @ c.gRl[k]
        T = c.gRl[k].T @ (pose[:3, 3] - c.centres[k])
        expected = function("printed (19)")(R.ravel(), T, q[k], *semi_axes[k])
        assert_same(H[k], expected[:, :6], scale)
        assert_same(D[k], expected[:, 6:], np.ones(6))


def test_sun_tilt(case: View) -> None:
    pose, _ = camera_columns(case)
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction, u = rng.normal(size=3), 0.3 * rng.normal(size=2)
        direction /= np.linalg.norm(direction)
        J = np.empty((1, 6))
        _, strength = sun.sun_tilt(pose, EYE, direction, *u, J)
        assert strength > 0.0
        assert_allclose(J, function("tilt")(pose[:3, :3].T @ direction, u), atol=1e-9)


def test_twist_of_a_mounted_camera(case: View) -> None:
    """Against the adjoint of GTSAM's pose."""
    J = np.random.default_rng(0).normal(size=(7, 6))
    out = np.empty((7, 6))
    conic.body_columns(J, case.bTc, out)
    assert_allclose(out, J @ gtsam.Pose3(case.bTc).inverse().AdjointMap(), atol=1e-12)
