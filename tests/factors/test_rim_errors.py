"""Errors of rims as variables of the conic-shape factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from factors.checking import numerical_jacobian
from factors.conic_shape import ChartError, conic_shape_factors
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import robust
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes, tilt_slopes
from factors.rims_with_errors import RimsWithErrors

POSE = np.array(
    [[1.0, 0.0, 0.0, 300.0], [0.0, -1.0, 0.0, -500.0], [0.0, 0.0, -1.0, 20e3], [0.0, 0.0, 0.0, 1.0]]
)
# In rows, as cameras hold it: kernels are compiled for each order.
MOUNTING = np.ascontiguousarray(
    gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 0.4), np.array([1.0, -0.5, 0.3])).matrix()
)
CENTRES = np.array([[0.0, 0.0, 0.0], [2000.0, -1500.0, 50.0], [-2500.0, 800.0, -30.0]])
AXES = np.array([[[900.0, 100.0, 0.0], [-80.0, 720.0, 0.0]]] * 3)
OWN = [gtsam.symbol("r", i) for i in (3, 4, 7)]
ALL, LENS = gtsam.symbol("s", 0), gtsam.symbol("k", 0)


def made(
    loss: Loss = Loss(),
) -> tuple[list[gtsam.CustomFactor], RimsWithErrors, gtsam.Values]:
    """Three rims with an error each and one that they share: as factors, and together."""
    rng = np.random.default_rng(1)
    charts, seen = project_rims(POSE, MOUNTING, CENTRES, AXES)
    assert seen.all()
    charts = charts + 1e-3 * rng.standard_normal(charts.shape)
    S = np.tile(1e-6 * (0.5 + np.eye(5)), (3, 1, 1))
    errors = [
        ChartError(OWN, 1e-3 * rng.standard_normal((3, 5, 5))),
        ChartError([ALL] * 3, 1e-3 * rng.standard_normal((3, 5, 4))),
    ]
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(POSE))
    for key in OWN:
        values.insert(key, rng.standard_normal(5))
    values.insert(ALL, rng.standard_normal(4))
    fields = X(0), MOUNTING, CENTRES, AXES, charts, S, errors, loss
    together = RimsWithErrors()
    together.add(*fields)
    return conic_shape_factors(*fields), together, values


def test_derivatives() -> None:
    factors, _, values = made()
    for factor, own in zip(factors, OWN, strict=True):
        A, _ = factor.linearize(values).jacobian()
        steps = {X(0): [1e-5] * 3 + [1.0] * 3, own: [0.1] * 5, ALL: [0.1] * 4}
        assert list(factor.keys()) == list(steps)
        column = 0
        for key, step in steps.items():
            expected = numerical_jacobian(factor, values, key, step)
            block = A[:, column : column + expected.shape[1]]
            column += expected.shape[1]
            assert_allclose(block, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_gradient_under_a_loss() -> None:
    """The linearised factor has the gradient of the loss in the pose and in the errors."""
    factors, _, values = made(Loss(robust.HUBER, 0.5))
    A, b = factors[0].linearize(values).jacobian()
    gradient = -A.T @ b
    for key, column, steps in (
        (X(0), 0, [1e-6] * 3 + [0.1] * 3),
        (OWN[0], 6, [1e-4] * 5),
        (ALL, 11, [1e-4] * 4),
    ):
        for i, step in enumerate(steps):
            costs = []
            for side in (step, -step):
                moved = gtsam.VectorValues()
                moved.insert(key, side * np.eye(len(steps))[i])
                costs.append(factors[0].error(values.retract(moved)))
            expected = (costs[0] - costs[1]) / (2.0 * step)
            assert_allclose(gradient[column + i], expected, rtol=1e-4, atol=1e-5)


def test_an_error_moves_its_rim_alone() -> None:
    factors, _, values = made()
    before = [factor.unwhitenedError(values).copy() for factor in factors]
    values.update(OWN[1], values.atVector(OWN[1]) + 1.0)
    moved = [(factor.unwhitenedError(values) != e).all() for factor, e in zip(factors, before, strict=True)]
    assert moved == [False, True, False]


def test_a_rim_out_of_sight_has_no_pull_on_its_error() -> None:
    factors, _, values = made()
    away = POSE.copy()
    away[:3, :3] = away[:3, :3] @ gtsam.Rot3.Rx(np.pi).matrix()
    values.update(X(0), gtsam.Pose3(away))
    for factor in factors:
        A, _ = factor.linearize(values).jacobian()
        assert not A.any()


@pytest.mark.parametrize("loss", [Loss(), Loss(robust.HUBER, 0.5), Loss(robust.TRUNCATED, 0.5)])
@pytest.mark.parametrize("third", [False, True])
def test_rims_together_are_their_factors(loss: Loss, third: bool) -> None:
    """At several poses, one of which sees nothing; also with errors of other lengths, and with three."""
    factors, together, values = made(loss)
    charts, _ = project_rims(POSE, MOUNTING, CENTRES, AXES)
    S = np.tile(1e-6 * np.eye(5), (3, 1, 1))
    for n, turn in enumerate((1e-3, np.pi), 1):
        errors = [
            ChartError(OWN, np.full((3, 5, 5), 1e-3)),
            ChartError([LENS] * 3, np.ones((3, 5, 2)) * 1e-4),
        ]
        if third:
            errors.insert(1, ChartError([ALL] * 3, np.full((3, 5, 4), 2e-3)))
        fields = X(n), MOUNTING, CENTRES, AXES, charts, S, errors, loss
        factors += conic_shape_factors(*fields)
        together.add(*fields)
        values.insert(X(n), gtsam.Pose3(POSE).compose(gtsam.Pose3(gtsam.Rot3.Rx(turn), np.zeros(3))))
    values.insert(LENS, np.array([0.3, -0.2]))
    graph, linear = gtsam.NonlinearFactorGraph(), gtsam.GaussianFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    assert together.rows == sum(factor.dim() for factor in factors)
    for _ in range(2):
        assert together.error(values) == pytest.approx(graph.error(values), rel=1e-14)
        together.linearise(values, linear)
        ordering = gtsam.Ordering()
        for key in values.keys():  # noqa: SIM118 (Values is no mapping)
            ordering.push_back(key)
        found, expected = (g.hessian(ordering) for g in (linear, graph.linearize(values)))
        for a, b in zip(found, expected, strict=True):
            assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())
        # The arrays are used again.
        values.update(X(0), gtsam.Pose3(POSE).retract(np.array([1e-3, 0.0, 0.0, 0.0, 30.0, 0.0])))
        linear = gtsam.GaussianFactorGraph()


def test_what_is_not_finite_is_named() -> None:
    _, together, values = made()
    values.update(OWN[2], np.array([np.nan, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(FactorError, match="factor at x0: residual or Jacobian is not finite"):
        together.error(values)


def test_of_several_that_are_not_finite_the_first_is_named() -> None:
    _, together, values = made()
    charts, _ = project_rims(POSE, MOUNTING, CENTRES, AXES)
    own = [gtsam.symbol("r", i) for i in (8, 9, 10)]
    errors = [ChartError(own, np.ones((3, 5, 5))), ChartError([LENS] * 3, np.ones((3, 5, 4)))]
    S = np.tile(1e-6 * np.eye(5), (3, 1, 1))
    together.add(X(1), MOUNTING, CENTRES, AXES, charts, S, errors, Loss())
    values.insert(X(1), gtsam.Pose3(POSE))
    values.insert(LENS, np.zeros(4))
    for key in own:
        values.insert(key, np.full(5, np.nan))
    values.update(OWN[0], np.full(5, np.nan))
    with pytest.raises(FactorError, match="factor at x0"):
        together.error(values)


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


def test_tilts_raise_the_semi_axes() -> None:
    slopes = tilt_slopes(POSE, MOUNTING, CENTRES, AXES)
    assert slopes.shape == (len(CENTRES), 5, 2)
    normals = np.cross(AXES[:, 0], AXES[:, 1])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    h = 1e-5
    for j in range(2):
        charts = []
        for side in (h, -h):
            axes = AXES.copy()
            axes[:, j] += side * np.linalg.norm(AXES[:, j], axis=1)[:, None] * normals
            charts.append(project_rims(POSE, MOUNTING, CENTRES, axes)[0])
        assert_allclose(slopes[:, :, j], (charts[0] - charts[1]) / (2.0 * h), rtol=1e-6, atol=1e-8)
    assert np.abs(slopes).max() > 0.01


def test_roots_of_another_shape_are_refused() -> None:
    S = np.tile(1e-6 * np.eye(5), (3, 1, 1))
    charts, _ = project_rims(POSE, MOUNTING, CENTRES, AXES)
    fields = X(0), MOUNTING, CENTRES, AXES, charts
    for keys, roots in ((OWN, np.zeros((3, 5))), (OWN, np.zeros((2, 5, 3))), (OWN[:2], np.zeros((3, 5, 3)))):
        with pytest.raises(FactorError, match=r"errors\[0\]: expected 3 keys and roots"):
            conic_shape_factors(*fields, S, [ChartError(keys, roots)])
    with pytest.raises(FactorError, match=r"errors.roots: expected finite"):
        conic_shape_factors(*fields, S, [ChartError(OWN, np.full((3, 5, 3), np.nan))])
    with pytest.raises(FactorError, match=r"covariances\[0\]: expected a positive definite"):
        conic_shape_factors(*fields, -S, [ChartError(OWN, np.zeros((3, 5, 3)))])
