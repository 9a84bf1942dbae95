import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from craternav_fg import frames
from factors.kernels import conic
from tests.factors.conftest import View, make_view, rim_points
from tests.factors.conics import conic_to_chart


def test_chart_is_the_image_of_the_rim(view: View) -> None:
    for row, y in enumerate(view.charts):
        u = rim_points(view, row, np.linspace(0.0, 2 * np.pi, 40, endpoint=False))
        sxx = np.exp(2 * y[2])
        sxy = y[3] * sxx
        S = np.array([[sxx, sxy], [sxy, np.exp(2 * y[4]) + sxy**2 / sxx]])
        d = u - y[:2]
        assert_allclose(np.einsum("ni,ij,nj->n", d, np.linalg.inv(S), d), 1.0, rtol=1e-9)


def test_conic_vanishes_on_the_rim(view: View) -> None:
    for row, y in enumerate(view.charts):
        A, B, C, D, E, F = conic.chart_to_conic(y)
        u, v = rim_points(view, row, np.linspace(0.0, 6.0, 20)).T
        assert_allclose(A * u * u + B * u * v + C * v * v + D * u + E * v + F, 0.0, atol=1e-12)


def test_conic_matches_the_forward_model(view: View) -> None:
    """Q = R H^-T diag(1/a^2, 1/b^2, -1) H^-1 R', eqs. (14) to (17)."""
    gTc = view.gTb @ view.bTc
    for row, y in enumerate(view.charts):
        gRl = view.catalog.gRl[row]
        R = gTc[:3, :3].T @ gRl
        T = gRl.T @ (gTc[:3, 3] - view.catalog.centres[row])
        H = np.array([[1.0, 0.0, -T[0]], [0.0, 1.0, -T[1]], [0.0, 0.0, -T[2]]])
        shape = np.diag([view.catalog.semi_major_m[row] ** -2, view.catalog.semi_minor_m[row] ** -2, -1.0])
        Hi = np.linalg.inv(H)
        Q = R @ Hi.T @ shape @ Hi @ R.T
        q = np.array([Q[0, 0], 2 * Q[0, 1], Q[1, 1], 2 * Q[0, 2], 2 * Q[1, 2], Q[2, 2]])
        assert_allclose(conic.chart_to_conic(y), q / np.linalg.norm(q) * np.sign(q[0]), atol=1e-11)


@pytest.mark.parametrize(
    ("altitude_m", "tilt_deg", "circular"),
    [(50e3, 20.0, False), (2e3, 60.0, False), (100e3, 0.0, True), (50e3, 1e-6, True), (5e3, 75.0, False)],
)
def test_jacobian_by_central_differences(altitude_m: float, tilt_deg: float, circular: bool) -> None:
    for seed in range(5):
        view = make_view(seed, altitude_m=altitude_m, tilt_deg=tilt_deg, circular=circular)
        args = (view.bTc, view.catalog.centres, view.catalog.axes)
        _, J, _ = conic.chart_jacobian(view.gTb, *args)
        for d in range(6):
            numerical = []
            for h in (1e-4, 5e-5) if d < 3 else (1e-4 * altitude_m, 5e-5 * altitude_m):
                step = np.zeros(6)
                step[d] = h
                ends = []
                for sign in (1.0, -1.0):
                    T = frames.pose(frames.rotation_exp(sign * step[:3]), sign * step[3:])
                    ends.append(conic.project_rims(view.gTb @ T, *args)[0])
                numerical.append((ends[0] - ends[1]) / (2 * h))
            scale = np.abs(J).max(axis=(0, 2))
            expected = (4 * numerical[1] - numerical[0]) / 3
            assert_allclose(
                J[:, :, d] / scale, expected / scale, atol=1e-6 * np.abs(J[:, :, d] / scale).max() + 1e-12
            )


charts = st.tuples(
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(-6.0, -1.0),
    st.floats(-2.0, 2.0),
    st.floats(-6.0, -1.0),
).map(np.array)


@settings(deadline=None)
@given(charts, st.floats(1e-3, 1e3), st.sampled_from([-1.0, 1.0]))
def test_chart_survives_sign_and_scale_of_the_conic(y: np.ndarray, scale: float, sign: float) -> None:
    assert_allclose(conic_to_chart(sign * scale * conic.chart_to_conic(y)), y, atol=1e-6)


@settings(deadline=None)
@given(charts)
def test_conic_jacobian_is_tangent_to_the_unit_sphere_and_right(y: np.ndarray) -> None:
    J = conic.chart_to_conic_jacobian(y)
    assert_allclose(conic.chart_to_conic(y) @ J, 0.0, atol=1e-9)
    h = 1e-5
    numerical = np.stack(
        [(conic.chart_to_conic(y + h * e) - conic.chart_to_conic(y - h * e)) / (2 * h) for e in np.eye(5)],
        axis=1,
    )
    assert_allclose(J, numerical, atol=1e-6 * max(1.0, np.abs(J).max()))


def test_hyperbola_and_hidden_rims_are_not_ellipses() -> None:
    assert np.isnan(conic_to_chart(np.array([1.0, 0.0, -1.0, 0.0, 0.0, -1.0]))).all()
    view = make_view(0)
    args = (view.bTc, view.catalog.centres, view.catalog.axes)
    turned = (
        view.gTb @ view.bTc @ frames.pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ frames.inverse(view.bTc)
    )
    assert not conic.project_rims(turned, *args)[1].any()
    inside = view.gTb.copy()
    inside[:3, 3] -= 2 * (view.gTb[:3, 3] - view.catalog.centres.mean(axis=0))
    assert not conic.project_rims(inside, *args)[1].any()
