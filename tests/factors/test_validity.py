"""Poses at which a crater has no image: finite answers, as `factors.kernels.validity` lists them."""

import gtsam
import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.estimators.optimise import levenberg_marquardt
from factors.custom import Loss
from factors.kernels import robust, validity
from tests.factors.conftest import View, make_view
from tests.factors.test_factors import FACTORS, values_at

# Factors that give up at each kind of pose.
UNSEEN = {
    "behind": {"shape", "implicit", "shape_beside_los", "los", "centre", "rim"},
    # Rounding decides on which side a centre in the plane lies: line of sight and centre need only be finite.
    "in the camera's plane": {"shape", "implicit", "shape_beside_los", "rim"},
    "from below": {"shape", "implicit", "shape_beside_los", "los", "rim"},
    "hyperbola": {"shape", "implicit", "shape_beside_los", "rim"},
}


def pose_of(view: View, kind: str) -> np.ndarray:
    """A body pose that sees crater 0 as `kind` says."""
    gTc = view.gTb @ view.bTc
    L, n = view.catalog.centres[0], view.catalog.normals[0]
    x = view.catalog.gRl[0, :, 0]
    if kind == "behind":
        gTc = gTc @ frames.pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    elif kind == "in the camera's plane":
        gTc = frames.pose(np.stack([x, -n, np.cross(x, -n)], axis=-1), L + 1e4 * n)
        # To the last digit: the centre is in the plane through the camera.
        gTc[:3, 3] -= gTc[:3, 2] * (gTc[:3, 2] @ (gTc[:3, 3] - L))
    elif kind == "from below":
        gTc = frames.pose(gTc[:3, :3] @ np.diag([1.0, -1.0, -1.0]), 2.0 * L - gTc[:3, 3])
    else:
        z = np.cos(0.5) * x - np.sin(0.5) * n
        y = np.cross(z, x)
        y /= np.linalg.norm(y)
        b = view.catalog.semi_minor_m[0]
        gTc = frames.pose(np.stack([np.cross(y, z), y, z], axis=-1), L + 0.3 * b * (n - x))
    return gTc @ frames.inverse(view.bTc)


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize("kind", UNSEEN)
def test_finite_and_dear_where_the_table_says(kind: str, name: str) -> None:
    for seed in range(3):
        view = make_view(seed, n=1)
        factor = FACTORS[name](view, Loss())
        at = values_at(pose_of(view, kind))
        assert np.isfinite(factor.error(at))
        J, b = factor.linearize(at).jacobian()
        assert np.isfinite(J).all()
        assert np.isfinite(b).all()
        if name in UNSEEN[kind]:
            assert (np.abs(b) == validity.UNSEEN).all()
            assert (J == 0.0).all()
        elif name != "sun" and kind != "in the camera's plane":
            assert not (np.abs(b) == validity.UNSEEN).any()
            assert np.abs(J).max() > 0.0


@pytest.mark.parametrize("name", FACTORS)
def test_finite_up_to_the_last_digit_before_it_is_lost(name: str) -> None:
    """From a good pose to each bad one, bisected to where the answer changes, and all along the way."""
    view = make_view(1, n=1)
    factor = FACTORS[name](view, Loss())
    good = gtsam.Pose3(view.gTb)
    for kind in UNSEEN:
        twist = good.localCoordinates(gtsam.Pose3(pose_of(view, kind)))

        def lost(share: float, twist: np.ndarray = twist) -> bool:
            J, b = factor.linearize(values_at(good.retract(share * twist).matrix())).jacobian()
            assert np.isfinite(J).all()
            assert np.isfinite(b).all()
            return bool((np.abs(b) == validity.UNSEEN).all())

        grid = [lost(share) for share in np.linspace(0.0, 1.0, 200)]
        if True in grid:
            low, high = (grid.index(True) - 1) / 199.0, grid.index(True) / 199.0
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if lost(middle) else (middle, high)


@pytest.mark.parametrize("name", ["shape", "implicit", "los", "centre"])
def test_a_lost_crater_spoils_no_other(name: str) -> None:
    view = make_view(0, n=4)
    centres = view.catalog.centres.copy()
    whole, b_whole = FACTORS[name](view, Loss()).linearize(values_at(view.gTb)).jacobian()
    gTc = view.gTb @ view.bTc
    # The catalogue is asked for arrays only: its second crater is moved behind the camera.
    centres[1] = 2.0 * gTc[:3, 3] - centres[1]
    catalog = _Moved(view.catalog, centres)
    lost = type(view)(catalog, view.gTb, view.bTc, view.charts, view.covariances)
    J, b = FACTORS[name](lost, Loss()).linearize(values_at(view.gTb)).jacobian()
    rows = len(b) // 4
    others = np.r_[0:rows, 2 * rows : 4 * rows]
    np.testing.assert_array_equal(J[others], whole[others])
    np.testing.assert_array_equal(b[others], b_whole[others])
    assert (np.abs(b[rows : 2 * rows]) == validity.UNSEEN).all()


@pytest.mark.parametrize("kind", [robust.HUBER, robust.CAUCHY, robust.GEMAN_MCCLURE, robust.TRUNCATED])
def test_the_loss_bounds_a_lost_crater_too(kind: int) -> None:
    view = make_view(0, n=1)
    at = values_at(pose_of(view, "behind"))
    plain = FACTORS["shape"](view, Loss()).error(at)
    loss = Loss(kind, 3.0)
    error = FACTORS["shape"](view, loss).error(at)
    assert 2.0 * error == pytest.approx(robust.loss_and_weight(2.0 * plain, kind, 3.0)[0])
    assert error < 1e-3 * plain


@pytest.mark.parametrize("name", ["shape", "los", "centre"])
def test_levenberg_marquardt_steps_back_from_a_pose_that_loses_the_craters(name: str) -> None:
    """From so high above the Moon that the undamped first step loses every crater."""
    view = make_view(3, n=6)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(FACTORS[name](view, Loss()))
    back = frames.pose(np.eye(3), np.array([0.0, 0.0, -200e3]))
    start = values_at(view.gTb @ view.bTc @ back @ frames.inverse(view.bTc))
    step = start.retract(graph.linearize(start).optimize())
    assert (np.abs(graph.linearize(step).at(0).jacobian()[1]) == validity.UNSEEN).all()
    result = levenberg_marquardt(graph, start)
    assert result.converged
    J, b = graph.linearize(result.values).at(0).jacobian()
    assert not (np.abs(b) == validity.UNSEEN).any()
    assert np.abs(J.T @ b / np.abs(J).max(axis=0)).max() < 1e-6


class _Moved:
    def __init__(self, catalog: object, centres: np.ndarray) -> None:
        self.catalog = catalog
        self.centres = centres

    def __getattr__(self, name: str) -> object:
        return getattr(self.catalog, name)
