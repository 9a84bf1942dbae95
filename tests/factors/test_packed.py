"""The packed kernel against its parts, and what its factor does with numbers that are not."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from factors import validation
from factors.conic_shape import conic_shape_factor
from factors.custom import Loss, packed_pose_factor
from factors.errors import FactorError
from factors.kernels import conic, packed, robust, validity
from tests.factors.conftest import View, make_view

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


def system(out: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Sums of products (7, 7) of the columns J and e, in units in which those of a whole frame are one."""
    columns = out / scale[:, None]
    return columns @ columns.T


def frame(seed: int, n: int, altitude_m: float, kind: int) -> tuple[np.ndarray, np.ndarray, View]:
    """Pose near a view's, and what the kernels take of its rims."""
    view = make_view(seed, n=n, altitude_m=altitude_m, tilt_deg=45.0)
    c = view.catalog
    gTb = gtsam.Pose3(view.gTb).retract(np.array([1e-3, -2e-3, 3e-3, 20.0, -30.0, 40.0])).matrix()
    W = validation.whitening("covariances", view.covariances, n, 5)
    return gTb, packed.pack(view.bTc, c.centres, c.axes, view.charts, W, kind, 1.5), view


@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize(("n", "altitude_m"), [(2, 5e3), (3, 100e3), (10, 50e3), (31, 20e3)])
def test_seven_rows_are_the_same_quadratic(n: int, altitude_m: float, kind: int) -> None:
    """Random views; of two small rims from afar, a turn and a shift can hardly be told apart."""
    for seed in range(5):
        gTb, data, _ = frame(seed, n, altitude_m, kind)
        full, seven = np.zeros((7, 5 * n)), np.full((7, 7), np.nan)
        packed.shape_residuals(gTb, data, True, full)
        assert np.isfinite(packed.reduced_shape_residuals(gTb, data, True, seven))
        scale = np.maximum(np.linalg.norm(full, axis=1), 1e-9)
        assert_allclose(system(seven, scale), system(full, scale), atol=1e-13)
        # What the system says of the least determined direction is not lost either.
        singular = [np.linalg.svd(out[:6] / scale[:6, None], compute_uv=False) for out in (full, seven)]
        assert_allclose(singular[1], singular[0], rtol=1e-9, atol=1e-14)
        packed.shape_residuals(gTb, data, False, full)
        packed.reduced_shape_residuals(gTb, data, False, seven)
        assert_allclose(seven[6] @ seven[6], full[6] @ full[6], rtol=1e-12)


@pytest.mark.parametrize("kind", LOSSES)
def test_gradient_of_seven_rows(kind: int) -> None:
    """Against central differences of the error, which a loss bends."""
    gTb, data, _ = frame(3, 6, 50e3, kind)
    factor = packed_pose_factor(X(0), 7, packed.reduced_shape_residuals, data)
    steps = np.repeat([1e-8, 1e-4], 3)

    def error(twist: np.ndarray) -> float:
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose3(gTb).retract(twist))
        return float(factor.error(values))

    at = gtsam.Values()
    at.insert(X(0), gtsam.Pose3(gTb))
    J, b = factor.linearize(at).jacobian()
    expected = [(error(step) - error(-step)) / 2.0 for step in np.diag(steps)]
    assert_allclose(-(J.T @ b) * steps, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def test_seven_rows_with_rims_out_of_sight() -> None:
    """One of them, all but one, and all: then nothing but the error is left."""
    gTb, data, view = frame(0, 4, 50e3, robust.HUBER)
    camera = (gTb @ view.bTc)[:3, 3]
    for hidden in (1, 3, 4):
        spoilt = data.copy()
        for k in range(hidden):
            place = packed.HEADER + packed.CRATER * k
            spoilt[place : place + 3] = 2.0 * camera - spoilt[place : place + 3]
        full, seven = np.zeros((7, 20)), np.full((7, 7), np.nan)
        packed.shape_residuals(gTb, spoilt, True, full)
        assert np.isfinite(packed.reduced_shape_residuals(gTb, spoilt, True, seven))
        scale = np.maximum(np.linalg.norm(full, axis=1), 1e-9)
        assert_allclose(system(seven, scale), system(full, scale), atol=1e-13)
        assert (full[:6] == 0.0).all() == (hidden == 4)


@pytest.mark.parametrize("spoil", ["nothing", "zero column", "two equal columns", "one row", "units"])
def test_triangular_factor_of_any_matrix(spoil: str) -> None:
    rng = np.random.default_rng(5)
    A = rng.normal(size=(7, 20))
    if spoil == "zero column":
        A[2] = 0.0
    elif spoil == "two equal columns":
        A[4] = A[1]
    elif spoil == "one row":
        A[:, 1:] = 0.0
    elif spoil == "units":
        A *= 10.0 ** np.arange(-12, 16, 4)[:, None]
    R = np.full((7, 7), np.nan)
    packed.triangularise(A.copy(), R)
    assert not np.triu(R, 1).any()
    lengths = np.maximum(np.linalg.norm(A, axis=1), 1e-300)
    expected = (A / lengths[:, None]) @ (A / lengths[:, None]).T
    assert_allclose((R / lengths[:, None]) @ (R / lengths[:, None]).T, expected, atol=1e-14)
    assert R[6, 6] >= 0.0


@pytest.mark.parametrize("place", [9, 14])
def test_numbers_that_are_not_finite_raise(place: int) -> None:
    """A measured chart or a whitening that went bad after the factor was built."""
    view = make_view(0)
    c = view.catalog
    W = validation.whitening("covariances", view.covariances, 5, 5)
    data = packed.pack(view.bTc, c.centres, c.axes, view.charts, W, robust.NONE, 1.0)
    data[packed.HEADER + packed.CRATER + place] = np.inf
    values = gtsam.Values()
    values.insert(X(3), gtsam.Pose3(view.gTb))
    for rows, kernel in ((25, packed.shape_residuals), (7, packed.reduced_shape_residuals)):
        factor = packed_pose_factor(X(3), rows, kernel, data)
        for evaluate in (factor.linearize, factor.error):
            with pytest.raises(FactorError, match="x3: residual or Jacobian is not finite"):
                evaluate(values)
    with pytest.raises(FactorError, match="rows"):
        packed_pose_factor(X(3), 0, packed.shape_residuals, data)


def test_what_is_checked_at_once_is_packed_as_what_is_checked_by_field() -> None:
    """Arrays that are laid out otherwise take the other way; what is spoilt is refused in `test_refusals`."""
    view = make_view(2, n=6)
    c = view.catalog
    W = validation.whitening("covariances", view.covariances, 6, 5)
    expected = packed.pack(view.bTc, c.centres, c.axes, view.charts, W, robust.CAUCHY, 2.0)
    fields = (view.bTc, c.centres, c.axes, view.charts, view.covariances)
    assert_allclose(packed.pack_if_sound(*fields, robust.CAUCHY, 2.0), expected, rtol=1e-14)
    spoilt = view.covariances.copy()
    spoilt[5] = 0.0
    assert not len(packed.pack_if_sound(*fields[:4], spoilt, robust.CAUCHY, 2.0))
    away = gtsam.Values()
    away.insert(X(0), gtsam.Pose3(view.gTb).retract(np.array([1e-3, -2e-3, 3e-3, 20.0, -30.0, 40.0])))
    made = [
        conic_shape_factor(X(0), *others, Loss(robust.CAUCHY, 2.0))
        for others in (fields, [np.asfortranarray(field) for field in fields])
    ]
    assert made[0].error(away) == pytest.approx(made[1].error(away), rel=1e-12)


@pytest.mark.parametrize("m", [1, 2, 5])
def test_whitening(m: int) -> None:
    """Charts of very unequal components, against numpy's own Cholesky factor."""
    rng = np.random.default_rng(m)
    A = rng.normal(size=(20, m, m)) * 10.0 ** rng.uniform(-6, 2, (20, m, 1))
    S = A @ np.swapaxes(A, 1, 2)
    W = validation.whitening("S", S, 20, m)
    assert_allclose(W @ np.linalg.cholesky(S), np.broadcast_to(np.eye(m), S.shape), atol=1e-7)
    assert (np.triu(W, 1) == 0.0).all()
