"""Errors of rims as variables of the conic-shape factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, X
from numpy.testing import assert_allclose

from factors.checking import numerical_jacobian
from factors.conic_shape import ChartError, conic_shape_factor
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import robust
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes

POSE = np.array(
    [[1.0, 0.0, 0.0, 300.0], [0.0, -1.0, 0.0, -500.0], [0.0, 0.0, -1.0, 20e3], [0.0, 0.0, 0.0, 1.0]]
)
MOUNTING = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 0.4), np.array([1.0, -0.5, 0.3])).matrix()
CENTRES = np.array([[0.0, 0.0, 0.0], [2000.0, -1500.0, 50.0], [-2500.0, 800.0, -30.0]])
AXES = np.array([[[900.0, 100.0, 0.0], [-80.0, 720.0, 0.0]]] * 3)
ONE, ALL = gtsam.symbol("r", 3), gtsam.symbol("s", 0)


def factor(*, mounting: bool = False, loss: Loss = Loss()) -> tuple[gtsam.CustomFactor, gtsam.Values]:
    rng = np.random.default_rng(1)
    charts, seen = project_rims(POSE, MOUNTING, CENTRES, AXES)
    assert seen.all()
    charts = charts + 1e-3 * rng.standard_normal(charts.shape)
    roots = 1e-3 * rng.standard_normal((3, 5, 5)), 1e-3 * rng.standard_normal((3, 5, 4))
    S = np.tile(1e-6 * (0.5 + np.eye(5)), (3, 1, 1))
    errors = [ChartError(ONE, [1], roots[0][1:2]), ChartError(ALL, [0, 1, 2], roots[1])]
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(POSE))
    values.insert(C(0), gtsam.Pose3(MOUNTING))
    values.insert(ONE, rng.standard_normal(5))
    values.insert(ALL, rng.standard_normal(4))
    where = {"bTc": None, "mounting_key": C(0)} if mounting else {"bTc": MOUNTING}
    made = conic_shape_factor(
        X(0), where.get("bTc"), CENTRES, AXES, charts, S, loss,
        mounting_key=where.get("mounting_key"), errors=errors,
    )  # fmt: skip
    return made, values


@pytest.mark.parametrize("mounting", [False, True])
def test_derivatives(mounting: bool) -> None:
    made, values = factor(mounting=mounting)
    A, _ = made.linearize(values).jacobian()
    steps = {X(0): [1e-5] * 3 + [1.0] * 3, C(0): [1e-5] * 3 + [1.0] * 3, ONE: [0.1] * 5, ALL: [0.1] * 4}
    column = 0
    for key in list(made.keys()):
        expected = numerical_jacobian(made, values, key, steps[key])
        block = A[:, column : column + expected.shape[1]]
        column += expected.shape[1]
        assert_allclose(block, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_gradient_under_a_loss() -> None:
    """The linearised factor has the gradient of the loss in the errors, too."""
    made, values = factor(loss=Loss(robust.HUBER, 0.5))
    A, b = made.linearize(values).jacobian()
    gradient = -A.T @ b
    for key, column in ((ONE, 6), (ALL, 11)):
        for i in range(values.atVector(key).size):
            costs = []
            for side in (1e-4, -1e-4):
                moved = gtsam.VectorValues()
                moved.insert(key, side * np.eye(values.atVector(key).size)[i])
                costs.append(made.error(values.retract(moved)))
            assert_allclose(gradient[column + i], (costs[0] - costs[1]) / 2e-4, rtol=1e-4, atol=1e-5)


def test_an_error_moves_its_rim_alone() -> None:
    made, values = factor()
    before = made.unwhitenedError(values).copy()
    values.update(ONE, values.atVector(ONE) + 1.0)
    after = made.unwhitenedError(values).copy()
    assert (before != after).reshape(3, 5).all(axis=1).tolist() == [False, True, False]


def test_a_rim_out_of_sight_has_no_pull_on_its_error() -> None:
    made, values = factor()
    away = POSE.copy()
    away[:3, :3] = away[:3, :3] @ gtsam.Rot3.Rx(np.pi).matrix()
    values.update(X(0), gtsam.Pose3(away))
    A, _ = made.linearize(values).jacobian()
    assert not A.any()


def test_slopes_are_those_of_moved_and_stretched_rims() -> None:
    slopes = ground_slopes(POSE, MOUNTING, CENTRES, AXES)
    a, b = (np.linalg.norm(AXES[:, k], axis=1) for k in range(2))
    l1, l2 = AXES[:, 0] / a[:, None], AXES[:, 1] / b[:, None]
    directions = (l1, l2, np.cross(l1, l2))
    h = 1e-5

    def chart(j: int, side: float) -> np.ndarray:
        centres, axes = CENTRES.copy(), AXES.copy()
        if j < 3:
            centres += side * np.sqrt(a * b)[:, None] * directions[j]
        else:
            D = {3: (l1, l1), 4: (l1, l2), 5: (l2, l2)}[j]
            for u, v in [D, D[::-1]] if j == 4 else [D]:
                axes = axes + side * np.einsum("ni,nj,nkj->nki", u, v, AXES)
        return project_rims(POSE, MOUNTING, centres, axes)[0]

    for j in range(6):
        expected = (chart(j, h) - chart(j, -h)) / (2.0 * h)
        assert_allclose(slopes[:, :, j], expected, rtol=1e-6, atol=1e-8)


def test_roots_of_another_shape_are_refused() -> None:
    S = np.tile(1e-6 * np.eye(5), (3, 1, 1))
    charts, _ = project_rims(POSE, MOUNTING, CENTRES, AXES)
    with pytest.raises(FactorError, match=r"errors\[0\].roots"):
        conic_shape_factor(X(0), MOUNTING, CENTRES, AXES, charts, S, errors=[ChartError(ONE, [1], np.eye(5))])
