"""Every factor: derivative, zero at truth, loss, and what it refuses."""

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from factors.checking import numerical_jacobian
from factors.conic_shape import conic_shape_factor
from factors.crater_centre import crater_centre_factor
from factors.crater_los import crater_los_factor, line_of_sight
from factors.custom import Loss, pose_factor
from factors.errors import FactorError
from factors.implicit_shape import implicit_shape_factor
from factors.kernels import validity
from factors.kernels.sun import wrap
from factors.rim_points import rim_points_factor
from factors.shape_beside_los import shape_beside_los_factor
from factors.sun_tilt import sun_tilt_factor
from tests.factors.conftest import View, make_view, rim_points

Build = Callable[[View, Loss], gtsam.CustomFactor]


def shape(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c = view.catalog
    return conic_shape_factor(X(0), view.bTc, c.centres, c.axes, view.charts, view.covariances, loss)


def implicit(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c = view.catalog
    return implicit_shape_factor(X(0), view.bTc, c.centres, c.axes, view.charts, view.covariances, loss)


def los(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c = view.catalog
    gRc = (view.gTb @ view.bTc)[:3, :3]
    return crater_los_factor(X(0), view.bTc, c.centres, c.normals, view.charts, view.covariances, gRc, loss)


def centre(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    return crater_centre_factor(
        X(0), view.bTc, view.catalog.centres, view.charts[:, :2], view.covariances[:, :2, :2], loss
    )


def rim(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c = view.catalog
    turn = 2.0 * np.pi / 7.0
    points = [rim_points(view, i, turn * np.arange(1.0, 8.0)) for i in range(len(view.charts))]
    return rim_points_factor(X(0), view.bTc, c.centres, c.axes, points, [1e-4] * len(points), loss)


def shape_beside_los(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    c, gRc = view.catalog, (view.gTb @ view.bTc)[:3, :3]
    return shape_beside_los_factor(
        X(0), view.bTc, c.centres, c.axes, view.charts, view.covariances, gRc, loss
    )


def sun(view: View, loss: Loss = Loss()) -> gtsam.CustomFactor:
    east = view.catalog.gRl[0, :, 0]
    return sun_tilt_factor(X(0), view.bTc, east, 1.0, 0.1, (0.1, -0.2))


FACTORS: dict[str, Build] = {
    "shape": shape,
    "implicit": implicit,
    "los": los,
    "shape_beside_los": shape_beside_los,
    "centre": centre,
    "rim": rim,
    "sun": sun,
}


def values_at(gTb: np.ndarray, twist: np.ndarray | None = None) -> gtsam.Values:
    values = gtsam.Values()
    pose = gtsam.Pose3(gTb)
    values.insert(X(0), pose if twist is None else pose.retract(twist))
    return values


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize(
    ("altitude_m", "tilt_deg", "circular"),
    [(50e3, 20.0, False), (100e3, 0.0, True), (2e3, 55.0, False), (5e3, 75.0, False), (10e3, 1e-7, False)],
)
def test_jacobian(name: str, altitude_m: float, tilt_deg: float, circular: bool) -> None:
    for seed in range(4):
        view = make_view(seed, altitude_m=altitude_m, tilt_deg=tilt_deg, circular=circular)
        factor = FACTORS[name](view, Loss())
        twist = np.random.default_rng(seed).normal(0.0, [5e-3] * 3 + [5e-3 * altitude_m] * 3)
        for at in (values_at(view.gTb), values_at(view.gTb, twist)):
            J = factor.linearize(at).jacobian()[0]
            # A rim point's distance bends within the rim's radius.
            step = 2e-6 if name == "rim" else 2e-4
            expected = numerical_jacobian(factor, at, X(0), [step] * 3 + [step * altitude_m] * 3)
            columns = np.maximum(np.abs(J).max(axis=0), 1e-12)
            assert_allclose(J / columns, expected / columns, atol=1e-6)


@pytest.mark.parametrize("name", ["shape", "implicit", "los", "shape_beside_los", "rim"])
def test_zero_at_truth(view: View, name: str) -> None:
    assert FACTORS[name](view, Loss()).error(values_at(view.gTb)) < 1e-9


def test_line_of_sight_and_what_is_beside_it_are_eq_19(view: View) -> None:
    """Together they have the information of the conic-shape factor, and each less."""
    at = values_at(view.gTb)

    def information(factor: gtsam.CustomFactor) -> np.ndarray:
        J = factor.linearize(at).jacobian()[0]
        # In units in which the whole information is about one.
        return J.T @ J

    whole, parts = information(shape(view)), [information(los(view)), information(shape_beside_los(view))]
    scale = np.sqrt(np.diag(whole))
    assert_allclose(sum(parts) / np.outer(scale, scale), whole / np.outer(scale, scale), atol=1e-7)
    for part in parts:
        assert (
            np.linalg.slogdet(part / np.outer(scale, scale))[1]
            < -0.1 + np.linalg.slogdet(whole / np.outer(scale, scale))[1]
        )


def test_centre_is_not_zero_at_truth(view: View) -> None:
    """Perspective moves the ellipse's centre off the crater's: what the centre-based methods ignore."""
    assert centre(view).error(values_at(view.gTb)) > 1e-3


def test_line_of_sight_points_to_the_true_centre(view: View) -> None:
    gTc = view.gTb @ view.bTc
    for row, y in enumerate(view.charts):
        direction, S = line_of_sight(y, view.covariances[row], gTc[:3, :3].T @ view.catalog.normals[row])
        to_centre = gTc[:3, :3].T @ (view.catalog.centres[row] - gTc[:3, 3])
        assert_allclose(direction, to_centre / np.linalg.norm(to_centre), atol=1e-12)
        assert_allclose(S @ direction, 0.0, atol=1e-12)


def test_los_covariance_by_sampling() -> None:
    view = make_view(3)
    n_c = (view.gTb @ view.bTc)[:3, :3].T @ view.catalog.normals[0]
    S = view.covariances[0] * 1e-2
    draws = np.random.default_rng(0).multivariate_normal(view.charts[0], S, 20_000)
    sample = np.cov(np.array([line_of_sight(y, S, n_c)[0] for y in draws]).T)
    expected = line_of_sight(view.charts[0], S, n_c)[1]
    assert_allclose(sample, expected, atol=0.05 * np.abs(expected).max())


def test_measured_tilt_is_that_of_the_projected_direction(view: View) -> None:
    """The tilt is the image of a short step on the ground towards the sun."""
    gTc = view.gTb @ view.bTc
    foot = view.catalog.centres[0]
    towards = view.catalog.gRl[0, :, 0]
    ends = [(P - gTc[:3, 3]) @ gTc[:3, :3] for P in (foot, foot + 0.01 * towards)]
    start, end = (e[:2] / e[2] for e in ends)
    tilt = np.arctan2(end[1] - start[1], end[0] - start[0])
    factor = sun_tilt_factor(X(0), view.bTc, towards, tilt, 1e-3, start)
    assert abs(factor.whitenedError(values_at(view.gTb))[0]) < 1e-2


@pytest.mark.parametrize("angle", [-7.0, -np.pi, -3.0, 0.0, 3.0, np.pi, 7.0, 100.0])
def test_wrap(angle: float) -> None:
    wrapped = wrap(angle)
    assert -np.pi < wrapped <= np.pi
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-12)


def test_unseen_crater_is_dear_but_without_pull() -> None:
    view = make_view(2)
    away = (
        view.gTb
        @ view.bTc
        @ gtsam.Pose3(gtsam.Rot3.Rx(np.pi), np.zeros(3)).matrix()
        @ np.linalg.inv(view.bTc)
    )
    for name in ("shape", "implicit", "los", "centre", "rim"):
        factor = FACTORS[name](view, Loss())
        J, b = factor.linearize(values_at(away)).jacobian()
        assert (J == 0.0).all()
        assert (np.abs(b) == validity.UNSEEN).all()


def test_constructor_refuses_what_a_kernel_leaves_unwritten() -> None:
    def lazy(gTb: np.ndarray, bTc: np.ndarray, linearise: bool, e: np.ndarray, J: np.ndarray) -> None:
        e[:] = np.nan

    factor = pose_factor(X(0), 3, lazy, np.eye(4))
    with pytest.raises(FactorError, match="x0: residual or Jacobian is not finite"):
        factor.linearize(values_at(np.eye(4)))
    with pytest.raises(FactorError, match="rows"):
        pose_factor(X(0), 0, lazy, np.eye(4))


def test_jacobian_has_the_rows_that_were_declared(view: View) -> None:
    for name, rows in {"shape": 25, "implicit": 25, "los": 10, "centre": 10, "rim": 35, "sun": 1}.items():
        assert FACTORS[name](view, Loss()).linearize(values_at(view.gTb)).jacobian()[0].shape == (rows, 6)


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("charts", lambda a: a[:, :4], r"charts: expected shape \(5, 5\)"),
        ("charts", lambda a: np.where(np.arange(5) == 2, np.nan, a), "charts: expected finite"),
        ("centres", lambda a: a[:3], r"centres: expected shape"),
        ("axes", lambda a: a[:, ::-1], r"axes\[0\]: expected perpendicular semi-axes a >= b"),
        ("axes", lambda a: 0.0 * a, r"axes\[0\]: .* found lengths 0 and 0"),
        ("covariances", lambda a: -a, r"covariances\[0\]: expected a positive definite"),
        ("covariances", lambda a: a + np.triu(np.ones((5, 5)), 1), r"covariances\[0\]: expected a symmetric"),
        pytest.param("bTc", lambda a: 2.0 * a, "bTc: expected a homogeneous matrix", id="scaled"),
        pytest.param(
            "bTc", lambda a: a @ np.diag([1.0, 1, -1, 1]), "bTc: expected a homogeneous", id="mirrored"
        ),
    ],
)
def test_bad_measurements_are_refused(field: str, change: Callable[..., np.ndarray], message: str) -> None:
    view = make_view(0)
    arguments = {
        "bTc": view.bTc,
        "centres": view.catalog.centres,
        "axes": view.catalog.axes,
        "charts": view.charts,
        "covariances": view.covariances,
    }
    arguments[field] = change(arguments[field])
    with pytest.raises(FactorError, match=message):
        conic_shape_factor(X(0), **arguments)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma_rad": 0.0}, "sigma_rad"),
        ({"tilt_rad": np.inf}, "tilt_rad"),
        ({"direction": np.zeros(3)}, "direction"),
    ],
)
def test_bad_tilts_are_refused(change: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"direction": np.ones(3), "tilt_rad": 0.1, "sigma_rad": 0.1} | change
    with pytest.raises(FactorError, match=message):
        sun_tilt_factor(X(0), np.eye(4), **arguments)
