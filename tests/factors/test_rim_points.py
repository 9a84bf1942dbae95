"""Rim-point factor: edge points against the predicted rim."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar

from craternav_fg.ellipse import points_on
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import rim
from factors.kernels.robust import HUBER
from factors.rim_points import rim_points_factor
from tests.factors.conftest import View, make_view, rim_points
from tests.factors.test_factors import values_at
from tests.factors.test_robust import ESTIMATORS

ERROR = gtsam.symbol("s", 0)


def arcs(view: View, counts: tuple[int, ...] = (4, 7, 60, 1, 12)) -> list[np.ndarray]:
    """Points on an arc of a quarter of each rim."""
    return [rim_points(view, i, np.linspace(0.3, 0.3 + 0.5 * np.pi, n)) for i, n in enumerate(counts)]


def factor_of(view: View, points: list[np.ndarray], sigmas: list, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c = view.catalog
    return rim_points_factor(X(0), view.bTc, c.centres, c.axes, points, sigmas, loss)


def test_zero_at_truth_and_one_row_per_point(view: View) -> None:
    factor = factor_of(view, arcs(view), [1e-4] * 5)
    assert factor.dim() == 84
    assert_allclose(factor.whitenedError(values_at(view.gTb)), 0.0, atol=1e-7)


@pytest.mark.parametrize("offset", [0.02, -0.02])
def test_is_the_distance_to_the_rim(view: View, offset: float) -> None:
    """Against the nearest of all rim points, from points moved off the rim by a fiftieth of its size."""
    for row, y in enumerate(view.charts):
        size = np.exp(y[4])
        angles = np.linspace(0.0, 6.0, 9)
        on = rim_points(view, row, angles)
        tangent = rim_points(view, row, angles + 1e-6) - rim_points(view, row, angles - 1e-6)
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1) / np.linalg.norm(
            tangent, axis=-1, keepdims=True
        )
        normal *= np.sign(np.sum(normal * (on - y[:2]), axis=-1, keepdims=True))
        for point, angle in zip(on + offset * size * normal, angles, strict=True):
            nearest = minimize_scalar(
                lambda a, point=point, row=row: np.sum((rim_points(view, row, np.array([a])) - point) ** 2),
                bracket=(angle - 0.02, angle + 0.02),
            )
            distance = np.sign(offset) * np.sqrt(nearest.fun)
            # Sampson's distance is of first order; on a circle it is exact.
            assert_allclose(rim.rim_distance(*point, y, np.empty(5)), distance, rtol=0.02)


def test_exact_on_a_circle_at_any_distance() -> None:
    y = np.array([0.1, -0.2, np.log(0.05), 0.0, np.log(0.05)])
    for radius in (0.001, 0.03, 0.05, 0.2, 3.0):
        point = y[:2] + radius * np.array([np.cos(1.0), np.sin(1.0)])
        assert_allclose(rim.rim_distance(*point, y, np.empty(5)), radius - 0.05, rtol=1e-12)


def test_derivative_in_the_chart() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        y = np.array([0.1, -0.2, np.log(0.05), 0.4, np.log(0.03)]) + rng.normal(0.0, 0.02, 5)
        u, v = y[:2] + rng.normal(0.0, 0.05, 2)
        D, unused = np.empty(5), np.empty(5)
        rim.rim_distance(u, v, y, D)
        for k, h in enumerate(1e-6 * np.eye(5)):
            ends = [rim.rim_distance(u, v, y + sign * h, unused) for sign in (1.0, -1.0)]
            assert_allclose(D[k], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)


def test_point_at_the_centre_has_no_pull() -> None:
    y = np.array([0.1, -0.2, np.log(0.05), 0.4, np.log(0.03)])
    D = np.full(5, np.nan)
    assert -0.05 < rim.rim_distance(y[0], y[1], y, D) < -0.02
    assert (D == 0.0).all()


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_loss_begins_at_the_root_mean_square(kind: int) -> None:
    view = make_view(0)
    at = values_at(view.gTb, np.array([1e-3, -2e-3, 3e-3, 30.0, -60.0, 50.0]))
    points, sigmas = arcs(view), [1e-3, 2e-3, 3e-3, 4e-3, 5e-3]
    estimator = ESTIMATORS[kind]
    A, b = factor_of(view, points, sigmas).linearize(at).jacobian()
    total, information, bites = 0.0, np.zeros((6, 6)), 0
    begin = 0
    for p in points:
        block = slice(begin, begin + len(p))
        begin += len(p)
        d = float(np.linalg.norm(b[block]))
        loss = estimator(0.3 * np.sqrt(len(p)))
        bites += loss.weight(d) < 0.99
        total += loss.loss(d)
        information += loss.weight(d) * A[block].T @ A[block]
    assert bites > 2
    ours = factor_of(view, points, sigmas, Loss(kind, 0.3))
    assert_allclose(ours.error(at), total, rtol=1e-12)
    J = ours.linearize(at).jacobian()[0]
    assert_allclose(J.T @ J, information, rtol=1e-9, atol=1e-9 * np.abs(information).max())


def test_short_arcs_alone_give_the_pose(view: View) -> None:
    """A quarter of each of five rims, where no ellipse fit is usable."""
    points = arcs(view, (20,) * 5)
    start = values_at(view.gTb, np.array([1e-3, -1e-3, 2e-3, 40.0, 50.0, -60.0]))
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor_of(view, points, [1e-4] * 5))
    values = start
    for _ in range(15):
        values = values.retract(graph.linearize(values).optimize())
    local = gtsam.Pose3(view.gTb).localCoordinates(values.atPose3(X(0)))
    assert_allclose(local, 0.0, atol=1e-3)
    assert np.abs(local[:3]).max() < 1e-8


def moved_by(view: View, z: np.ndarray, loss: Loss = Loss()) -> tuple[gtsam.CustomFactor, np.ndarray]:
    """Factor of arcs of the rims as an error z of two components moves them, and the roots of the error."""
    rng = np.random.default_rng(4)
    roots = rng.normal(0.0, 1e-3, (5, 5, 2)) * np.array([0.1, 0.1, 1.0, 1.0, 1.0])[:, None]
    points = list(points_on(view.charts + roots @ z, 24)[:, :6])
    c = view.catalog
    factor = rim_points_factor(
        X(0), view.bTc, c.centres, c.axes, points, [1e-3] * 5, loss, error=(ERROR, roots)
    )
    return factor, roots


def both(gTb: np.ndarray, z: np.ndarray) -> gtsam.Values:
    values = values_at(gTb)
    values.insert(ERROR, z)
    return values


def test_zero_where_the_error_moves_the_rims_to_the_points(view: View) -> None:
    z = np.array([1.5, -2.0])
    factor, _ = moved_by(view, z)
    assert list(factor.keys()) == [X(0), ERROR]
    assert_allclose(factor.whitenedError(both(view.gTb, z)), 0.0, atol=1e-7)
    assert np.abs(factor.whitenedError(both(view.gTb, np.zeros(2)))).max() > 0.1


@pytest.mark.parametrize("loss", [Loss(), Loss(HUBER, 0.05)])
def test_derivative_in_the_error(view: View, loss: Loss) -> None:
    """Of half the squared norm, which the loss of each rim is part of."""
    z = np.array([0.4, 0.3])
    factor, _ = moved_by(view, np.array([1.5, -2.0]), loss)
    A, b = factor.linearize(both(view.gTb, z)).jacobian()
    gradient = -A[:, 6:].T @ b
    for k, step in enumerate(1e-5 * np.eye(2)):
        ends = [factor.error(both(view.gTb, z + sign * step)) for sign in (1.0, -1.0)]
        assert_allclose(gradient[k], (ends[0] - ends[1]) / 2e-5, rtol=1e-4)


def test_rims_out_of_sight_do_not_constrain_the_error(view: View) -> None:
    factor, _ = moved_by(view, np.zeros(2))
    away = view.gTb.copy()
    away[:3, 3] *= -1.0
    J = factor.linearize(both(away, np.zeros(2))).jacobian()[0]
    assert (J == 0.0).all()


def test_an_error_beside_a_variable_mounting_is_refused() -> None:
    with pytest.raises(FactorError, match="error: expected a known mounting"):
        rim_points_factor(
            X(0), None, np.zeros((1, 3)), [[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]], [np.zeros((3, 2))], [1.0],
            mounting_key=X(1), error=(ERROR, np.zeros((1, 5, 2))),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": [np.zeros((0, 2))]}, r"points\[0\]: expected at least one"),
        ({"points": [np.zeros(2)]}, r"points\[0\]: expected shape \(2, 2\), found \(2,\)"),
        ({"points": [np.full((3, 2), np.nan)]}, r"points\[0\]: expected finite"),
        ({"sigmas": [0.0]}, r"sigmas\[0\]: expected positive"),
        ({"sigmas": [[1.0, 1.0]]}, r"sigmas\[0\]: expected shape \(3,\)"),
        ({"sigmas": [np.inf]}, r"sigmas\[0\]: expected finite"),
        ({"sigmas": [1.0, 1.0]}, "sigmas: expected 1 craters, found 2"),
        ({"axes": [[[0.0, 1.0, 0.0], [2.0, 0.0, 0.0]]]}, r"axes\[0\]"),
        ({"bTc": np.ones((4, 4))}, "bTc"),
        ({"error": (1, np.zeros((2, 5, 8)))}, r"error: expected shape \(1, 5, 8\), found \(2, 5, 8\)"),
        ({"error": (1, np.zeros((1, 5, 0)))}, "error"),
        ({"error": (1, np.full((1, 5, 8), np.nan))}, "error: expected finite"),
        ({"points": [], "sigmas": [], "centres": np.empty((0, 3)), "axes": np.empty((0, 2, 3))}, "rows"),
    ],
)
def test_bad_points_are_refused(change: dict, message: str) -> None:
    arguments = {
        "bTc": np.eye(4),
        "centres": np.zeros((1, 3)),
        "axes": [[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]],
        "points": [np.zeros((3, 2))],
        "sigmas": [1.0],
    } | change
    with pytest.raises(FactorError, match=message):
        rim_points_factor(X(0), **arguments)
