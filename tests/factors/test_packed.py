"""The packed kernel against its parts, and what its factor does with numbers that are not."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from factors import validation
from factors.custom import packed_pose_factor
from factors.errors import FactorError
from factors.kernels import conic, packed, robust, validity
from tests.factors.conftest import make_view

LOSSES = (robust.NONE, robust.HUBER, robust.CAUCHY, robust.GEMAN_MCCLURE, robust.TRUNCATED)


@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize("linearise", [True, False])
@pytest.mark.parametrize("turn_rad", [0.0, 0.6, np.pi])
def test_a_frame_is_its_craters(kind: int, linearise: bool, turn_rad: float) -> None:
    """Near truth, with some craters out of sight, and with all of them behind the camera."""
    for seed in range(5):
        view = make_view(seed, altitude_m=5e3, tilt_deg=60.0, n=7)
        gTb = view.gTb @ view.bTc @ gtsam.Pose3(gtsam.Rot3.Rx(turn_rad), np.zeros(3)).matrix()
        gTb = gtsam.Pose3(gTb @ np.linalg.inv(view.bTc)).retract([1e-3, -2e-3, 3e-3, 20, -30, 40]).matrix()
        c = view.catalog
        W = validation.whitening("covariances", view.covariances, 7, 5)
        data = packed.pack(view.bTc, c.centres, c.axes, view.charts, W, kind, 1.5)
        out = np.zeros((7, 35))
        assert np.isfinite(packed.shape_residuals(gTb, data, linearise, out))

        y, J, visible = conic.chart_jacobian(gTb, view.bTc, c.centres, c.axes)
        for k in range(7):
            e, Je = np.full(5, validity.UNSEEN), np.zeros((5, 6))
            if visible[k]:
                e, Je = W[k] @ (y[k] - view.charts[k]), W[k] @ J[k]
            robust.apply_loss(e, Je, kind, 1.5, linearise)
            rows = slice(5 * k, 5 * k + 5)
            assert_allclose(out[6, rows], e, rtol=1e-9, atol=1e-9)
            if linearise:
                assert_allclose(out[:6, rows], Je.T, rtol=1e-8, atol=1e-9 * np.abs(Je).max(initial=1e-9))


@pytest.mark.parametrize("place", [9, 14])
def test_numbers_that_are_not_finite_raise(place: int) -> None:
    """A measured chart or a whitening that went bad after the factor was built."""
    view = make_view(0)
    c = view.catalog
    W = validation.whitening("covariances", view.covariances, 5, 5)
    data = packed.pack(view.bTc, c.centres, c.axes, view.charts, W, robust.NONE, 1.0)
    data[packed.HEADER + packed.CRATER + place] = np.inf
    factor = packed_pose_factor(X(3), 25, packed.shape_residuals, data)
    values = gtsam.Values()
    values.insert(X(3), gtsam.Pose3(view.gTb))
    with pytest.raises(FactorError, match="x3: residual or Jacobian is not finite"):
        factor.linearize(values)
    with pytest.raises(FactorError, match="rows"):
        packed_pose_factor(X(3), 0, packed.shape_residuals, data)


@pytest.mark.parametrize("m", [1, 2, 5])
def test_whitening(m: int) -> None:
    """Charts of very unequal components, against numpy's own Cholesky factor."""
    rng = np.random.default_rng(m)
    A = rng.normal(size=(20, m, m)) * 10.0 ** rng.uniform(-6, 2, (20, m, 1))
    S = A @ np.swapaxes(A, 1, 2)
    W = validation.whitening("S", S, 20, m)
    assert_allclose(W @ np.linalg.cholesky(S), np.broadcast_to(np.eye(m), S.shape), atol=1e-7)
    assert (np.triu(W, 1) == 0.0).all()
