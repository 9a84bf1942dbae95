"""Implicit shape factor: eq. (19) as printed, whitened at every pose."""

import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from craternav_fg import frames
from factors.conic_shape import conic_shape_factor
from factors.implicit_shape import implicit_shape_factor
from factors.kernels import conic, implicit, shape, validity
from tests.factors.conftest import View, make_view
from tests.factors.test_factors import values_at


def factor_of(view: View, charts: np.ndarray):
    c = view.catalog
    return implicit_shape_factor(X(0), view.bTc, c.centres, c.axes, charts, view.covariances)


def printed_chi2(view: View, charts: np.ndarray, gTb: np.ndarray) -> np.ndarray:
    """h' (J_q S_q J_q')^-1 h of every rim, formed as the paper prints it."""
    c = view.catalog
    semi_axes = np.stack([c.semi_major_m, c.semi_minor_m], axis=-1)
    q = np.array([conic.chart_to_conic(y) for y in charts])
    h, _, D, in_front = shape.shape_jacobian(gTb, view.bTc, c.centres, c.gRl, semi_axes, q)
    assert in_front.all()
    out = []
    for k in range(len(charts)):
        A = conic.chart_to_conic_jacobian(charts[k])
        M = D[k] @ A @ view.covariances[k] @ A.T @ D[k].T
        s = np.sqrt(np.diag(M))
        out.append((h[k] / s) @ np.linalg.solve(M / np.outer(s, s), h[k] / s))
    return np.array(out)


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1e-2])
def test_square_is_that_of_the_printed_equation_at_any_pose(view: View, scale: float) -> None:
    rng = np.random.default_rng(1)
    charts = view.charts + rng.multivariate_normal(np.zeros(5), 1e-2 * view.covariances[0], len(view.charts))
    factor = factor_of(view, charts)
    for _ in range(10):
        twist = rng.normal(0.0, scale, 6) * [1, 1, 1, 5e4, 5e4, 5e4]
        at = values_at(view.gTb, twist)
        e = factor.whitenedError(at).reshape(-1, 5)
        expected = printed_chi2(view, charts, at.atPose3(X(0)).matrix())
        assert (expected > 1e-3).all()
        assert_allclose(np.sum(e**2, axis=1), expected, rtol=1e-6)


def test_close_to_truth_it_is_the_chart_residual(view: View) -> None:
    """The two differ by the curvature of the map from chart to conic: quadratically in the residual."""
    c = view.catalog
    gaps = []
    for size in (1e-5, 1e-6):
        charts = view.charts + size * np.random.default_rng(0).normal(size=view.charts.shape)
        ours = factor_of(view, charts).whitenedError(values_at(view.gTb))
        chart = conic_shape_factor(X(0), view.bTc, c.centres, c.axes, charts, view.covariances)
        theirs = chart.whitenedError(values_at(view.gTb))
        gaps.append(np.abs(ours - theirs).max() / np.abs(theirs).max())
    assert gaps[0] < 0.05
    assert gaps[1] < 0.15 * gaps[0]


def test_silent_before_its_pole() -> None:
    """A predicted conic at a right angle to the measured one is a pole: the factor gives up before."""
    view = make_view(0, n=1, altitude_m=5e3)
    worst = 0.0
    unseen = 0
    for angle in np.linspace(0.0, 2.0 * np.pi, 4001):
        gTb = (
            view.gTb @ view.bTc
            @ frames.pose(frames.rotation_exp(np.array([angle, 0.3 * angle, 0.0])), np.zeros(3))
            @ frames.inverse(view.bTc)
        )  # fmt: skip
        linear = factor_of(view, view.charts).linearize(values_at(gTb))
        J, b = linear.jacobian()
        assert np.isfinite(J).all()
        if (np.abs(b) == validity.UNSEEN).all():
            unseen += 1
            assert (J == 0.0).all()
        else:
            worst = max(worst, np.linalg.norm(b))
    assert 0 < unseen < 4001
    sigma = np.sqrt(np.linalg.eigvalsh(view.covariances[0])[0])
    A = conic.chart_to_conic_jacobian(view.charts[0])
    assert worst < 1.0 / implicit.LEAST_COSINE / (sigma * np.linalg.svd(A)[1][-1])
