"""Losses on one crater's norm, against GTSAM's."""

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose

from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import robust
from tests.factors.conftest import make_view
from tests.factors.test_factors import FACTORS, values_at

ESTIMATORS = {
    robust.HUBER: gtsam.noiseModel.mEstimator.Huber.Create,
    robust.CAUCHY: gtsam.noiseModel.mEstimator.Cauchy.Create,
    robust.GEMAN_MCCLURE: gtsam.noiseModel.mEstimator.GemanMcClure.Create,
    robust.TRUNCATED: gtsam.noiseModel.mEstimator.TruncatedLeastSquares.Create,
}


@pytest.mark.parametrize("kind", ESTIMATORS)
@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_loss_and_weight_are_those_of_gtsam(kind: int, scale: float) -> None:
    estimator = ESTIMATORS[kind](scale)
    for d in [0.0, 1e-9, 0.1, 0.999 * scale, 1.001 * scale, 3.0 * scale, 1e4]:
        loss, weight = robust.loss_and_weight(d * d, kind, scale)
        assert_allclose(0.5 * loss, estimator.loss(d), rtol=1e-9, atol=1e-15)
        assert_allclose(weight, estimator.weight(d), rtol=1e-9)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_weight_is_the_slope_of_the_loss(kind: int) -> None:
    for d2 in [1e-3, 0.5, 2.8, 3.0, 40.0, 1e6]:
        h = 1e-5 * d2
        ends = [robust.loss_and_weight(d2 + s * h, kind, 1.7)[0] for s in (1.0, -1.0)]
        assert_allclose(robust.loss_and_weight(d2, kind, 1.7)[1], (ends[0] - ends[1]) / (2 * h), atol=1e-6)


@pytest.mark.parametrize("kind", ESTIMATORS)
@pytest.mark.parametrize("name", ["shape", "implicit", "los", "centre"])
def test_loss_equals_one_gtsam_robust_factor_per_crater(kind: int, name: str) -> None:
    view = make_view(1, n=6)
    at = values_at(view.gTb, np.array([1e-3, -2e-3, 3e-3, 300.0, -600.0, 500.0]))
    scale = 1.7
    estimator = ESTIMATORS[kind](scale)
    ours = FACTORS[name](view, Loss(kind, scale))
    rows = ours.dim() // 6
    plain = FACTORS[name](view, Loss()).linearize(at)
    A, b = plain.jacobian()
    total, information = 0.0, np.zeros((6, 6))
    for k in range(6):
        block = slice(rows * k, rows * (k + 1))
        d = float(np.linalg.norm(b[block]))
        total += estimator.loss(d)
        information += estimator.weight(d) * A[block].T @ A[block]
    assert total < 0.5 * float(b @ b), "the loss must bite for this test to tell anything"
    assert_allclose(ours.error(at), total, rtol=1e-12)
    J = ours.linearize(at).jacobian()[0]
    assert_allclose(J.T @ J, information, rtol=1e-10)


@pytest.mark.parametrize("kind", [robust.GEMAN_MCCLURE, robust.TRUNCATED])
@pytest.mark.parametrize("name", ["shape", "implicit", "los", "centre"])
def test_a_bounded_loss_takes_a_wrong_match_out(kind: int, name: str) -> None:
    """It costs no more than scale^2 / 2 and pulls next to nothing, wherever it lies."""
    view = make_view(1, n=6)
    at = values_at(view.gTb)
    right = FACTORS[name](view, Loss(kind, 3.0)).error(at)
    for shift in (0.2, 0.5):
        charts = view.charts.copy()
        charts[2, 0] += shift
        wrong = type(view)(view.catalog, view.gTb, view.bTc, charts, view.covariances)
        factor = FACTORS[name](wrong, Loss(kind, 3.0))
        A, _ = factor.linearize(at).jacobian()
        rows = len(A) // 6
        assert np.abs(A[2 * rows : 3 * rows]).max() < 1e-2 * np.abs(A[:rows]).max() + 1e-12
        assert factor.error(at) <= right + 0.5 * 9.0 * (1.0 + 1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((9, 1.0), "loss.kind"),
        ((1, 0.0), "loss.scale_sigmas"),
        ((1, np.nan), "loss.scale_sigmas"),
        ((1, np.inf), "scale"),
    ],
)
def test_bad_losses_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(FactorError, match=message):
        Loss(*arguments)
