"""Random views of craters that the factor tests share."""

from dataclasses import dataclass

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from factors.kernels import conic

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))


@dataclass(frozen=True)
class View:
    """Craters, a mounting and a pose that sees them."""

    catalog: Catalog
    gTb: np.ndarray
    bTc: np.ndarray
    charts: np.ndarray
    covariances: np.ndarray


def make_view(
    seed: int, *, n: int = 5, altitude_m: float = 50e3, tilt_deg: float = 20.0, circular: bool = False
) -> View:
    """Craters below a camera that is tilted off nadir and turned at random about its axis."""
    rng = np.random.default_rng(seed)
    site = rng.uniform(-1.0, 1.0, 2)
    spread = 0.15 * altitude_m / MOON.radius_m
    b = rng.uniform(0.01, 0.05, n) * altitude_m
    catalog = Catalog(
        tuple(f"C{i}" for i in range(n)),
        site[0] + rng.normal(0.0, spread, n),
        site[1] + rng.normal(0.0, spread, n) / np.cos(site[0]),
        b if circular else b * rng.uniform(1.01, 1.4, n),
        b,
        rng.uniform(-np.pi, np.pi, n),
        rng.uniform(-500.0, 500.0, n),
        MOON,
    )
    enu = frames.east_north_up(np.array(site[0]), np.array(site[1]))
    nadir = enu @ np.diag([1.0, -1.0, -1.0])
    axis = rng.normal(size=2)
    tilt = np.deg2rad(tilt_deg) * np.array([*axis / np.linalg.norm(axis), 0.0])
    gRc = nadir @ frames.rotation_exp(tilt) @ frames.rotation_exp(np.array([0, 0, rng.uniform(-3, 3)]))
    ground = (MOON.radius_m) * enu[:, 2]
    gTc = frames.pose(gRc, ground - gRc[:, 2] * altitude_m / np.cos(np.deg2rad(tilt_deg)))
    bTc = frames.pose(frames.rotation_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 2.0, 3))
    gTb = gTc @ frames.inverse(bTc)
    charts, visible = conic.project_rims(gTb, bTc, catalog.centres, catalog.axes)
    assert visible.all()
    A = rng.normal(size=(n, 5, 5)) * 1e-3
    return View(catalog, gTb, bTc, charts, A @ np.swapaxes(A, 1, 2) + 1e-7 * np.eye(5))


def rim_points(view: View, row: int, angles: np.ndarray) -> np.ndarray:
    """Normalised images (k, 2) of points on a rim, by projecting each point of space."""
    axes = view.catalog.axes[row]
    X = view.catalog.centres[row] + np.cos(angles)[:, None] * axes[0] + np.sin(angles)[:, None] * axes[1]
    gTc = view.gTb @ view.bTc
    x_c = (X - gTc[:3, 3]) @ gTc[:3, :3]
    return x_c[:, :2] / x_c[:, 2:]


@pytest.fixture(params=range(4))
def view(request: pytest.FixtureRequest) -> View:
    """Four random views."""
    return make_view(request.param)
