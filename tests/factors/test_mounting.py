"""The camera's mounting as a variable of every image factor."""

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, X
from numpy.testing import assert_allclose

from factors.checking import numerical_jacobian
from factors.conic_shape import conic_shape_factor
from factors.crater_centre import crater_centre_factor
from factors.crater_los import crater_los_factor
from factors.custom import Loss, pose_factor
from factors.errors import FactorError
from factors.implicit_shape import implicit_shape_factor
from factors.kernels import robust
from factors.rim_points import rim_points_factor
from factors.sun_tilt import sun_tilt_factor
from tests.factors.conftest import View, make_view, rim_points

# build(view, bTc, mounting_key): the same factor with a constant mounting or with a variable one.
Build = Callable[[View, np.ndarray | None, int | None], gtsam.CustomFactor]
LOSS = Loss(robust.CAUCHY, 2.0)


def shape(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    c = view.catalog
    return conic_shape_factor(
        X(0), bTc, c.centres, c.axes, view.charts, view.covariances, LOSS, mounting_key=key
    )


def implicit(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    c = view.catalog
    return implicit_shape_factor(
        X(0), bTc, c.centres, c.axes, view.charts, view.covariances, mounting_key=key
    )


def los(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    c = view.catalog
    gRc = (view.gTb @ view.bTc)[:3, :3]
    return crater_los_factor(
        X(0), bTc, c.centres, c.normals, view.charts, view.covariances, gRc, mounting_key=key
    )


def centre(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    return crater_centre_factor(
        X(0), bTc, view.catalog.centres, view.charts[:, :2], view.covariances[:, :2, :2], mounting_key=key
    )


def rim(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    c = view.catalog
    points = [rim_points(view, i, np.arange(1.0, 8.0)) for i in range(len(view.charts))]
    return rim_points_factor(X(0), bTc, c.centres, c.axes, points, [1e-3] * len(points), mounting_key=key)


def sun(view: View, bTc: np.ndarray | None, key: int | None) -> gtsam.CustomFactor:
    east = view.catalog.gRl[0, :, 0]
    return sun_tilt_factor(X(0), bTc, east, 1.0, 0.1, (0.1, -0.2), mounting_key=key)


FACTORS: dict[str, Build] = {
    "shape": shape,
    "implicit": implicit,
    "los": los,
    "centre": centre,
    "rim": rim,
    "sun": sun,
}


def values_at(view: View, twist: np.ndarray | None = None) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(view.gTb).retract(np.zeros(6) if twist is None else twist))
    values.insert(C(0), gtsam.Pose3(view.bTc))
    return values


@pytest.mark.parametrize("name", FACTORS)
def test_agrees_with_the_constant_mounting(view: View, name: str) -> None:
    at = values_at(view, np.array([1e-3, 2e-3, -1e-3, 10.0, 20.0, -30.0]))
    fixed = FACTORS[name](view, view.bTc, None)
    free = FACTORS[name](view, None, C(0))
    assert free.keys() == [X(0), C(0)]
    assert_allclose(free.error(at), fixed.error(at), rtol=1e-9)
    A, b = fixed.linearize(at).jacobian()
    both, b2 = free.linearize(at).jacobian()
    assert both.shape == (len(A), 12)
    assert_allclose(b2, b, rtol=1e-6, atol=1e-7)
    # Columns follow the keys' order: the mounting is `c`, the pose `x`.
    columns = np.maximum(np.abs(A).max(axis=0), 1e-12)
    assert_allclose(free_block(free, at, X(0)) / columns, A / columns, atol=1e-8)


def free_block(factor: gtsam.CustomFactor, values: gtsam.Values, key: int) -> np.ndarray:
    linear = factor.linearize(values)
    start = 6 * list(linear.keys()).index(key)
    return linear.jacobian()[0][:, start : start + 6]


@pytest.mark.parametrize("name", [n for n in FACTORS if n != "shape"] + ["shape-plain"])
@pytest.mark.parametrize("altitude_m", [50e3, 3e3])
def test_jacobian_of_both(name: str, altitude_m: float) -> None:
    for seed in range(3):
        view = make_view(seed, altitude_m=altitude_m)
        if name == "shape-plain":
            c = view.catalog
            factor = conic_shape_factor(
                X(0), None, c.centres, c.axes, view.charts, view.covariances, mounting_key=C(0)
            )
        else:
            factor = FACTORS[name](view, None, C(0))
        at = values_at(view, np.array([1e-3, 2e-3, -1e-3, 10.0, 20.0, -30.0]))
        h = 2e-6 if name == "rim" else 2e-4
        for key in (X(0), C(0)):
            J = free_block(factor, at, key)
            expected = numerical_jacobian(factor, at, key, [h] * 3 + [h * altitude_m] * 3)
            columns = np.maximum(np.abs(J).max(axis=0), 1e-12)
            assert_allclose(J / columns, expected / columns, atol=1e-6)


def test_a_wrong_mounting_is_found() -> None:
    """Known poses (as from an IMU) and rims: the mounting's 2 deg come out; its lever is below the noise."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = make_view(0)
    for i in range(6):
        view = make_view(i)
        gTb = view.gTb @ view.bTc @ np.linalg.inv(first.bTc)
        c = view.catalog
        graph.push_back(
            conic_shape_factor(
                X(i), None, c.centres, c.axes, view.charts, view.covariances, mounting_key=C(0)
            )
        )
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1e-5, 1.0], 3))
        graph.push_back(gtsam.PriorFactorPose3(X(i), gtsam.Pose3(gTb), sigmas))
        values.insert(X(i), gtsam.Pose3(gTb))
    wrong = gtsam.Pose3(first.bTc).retract(np.array([0.02, -0.03, 0.01, 0.5, 0.3, -0.2]))
    lever = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1.0, 1.0], 3))
    graph.push_back(gtsam.PriorFactorPose3(C(0), wrong, lever))
    values.insert(C(0), wrong)
    for _ in range(8):
        ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
        values = values.retract(graph.linearize(values).optimize(ordering, gtsam.EliminateQR))
    error = gtsam.Pose3(first.bTc).localCoordinates(values.atPose3(C(0)))
    assert np.abs(error[:3]).max() < 1e-4
    assert np.abs(error[3:]).max() < 2.0


def test_a_mounting_is_given_once() -> None:
    view = make_view(0)
    for bTc, key in ((None, None), (view.bTc, C(0))):
        for build in FACTORS.values():
            with pytest.raises(FactorError, match="bTc: expected either"):
                build(view, bTc, key)
    with pytest.raises(FactorError, match="mounting_key"):
        pose_factor(X(0), 1, lambda *_: None, None, X(0))
