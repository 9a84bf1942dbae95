"""Heights of rims from elevation models: where the planes lie, how sure they are, and what a model covers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.body import Body
from craternav_fg.catalogs.heights import (
    along_rims,
    implausible_heights,
    rims_within,
    unknown_beyond,
    with_covered_heights,
    with_rim_heights,
)
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog

BODY = Body("Moon", 1.7374e6, 4.9e12, (0.0, 0.0, 2.66e-6))
N = 12


@dataclass(frozen=True)
class Ground:
    """Stands for an elevation model: heights of directions (n, 3), on one side of a plane."""

    heights_m: Callable[[np.ndarray], np.ndarray]
    step_rad: float = 1e-7
    border: tuple[float, float, float, float] = (0.0, 0.0, 1.0, -2.0)

    def covers(self, directions: np.ndarray) -> np.ndarray:
        return directions @ self.border[:3] >= self.border[3]


@pytest.fixture
def catalog() -> Catalog:
    rng = np.random.default_rng(3)
    major = np.geomspace(2e3, 40e3, N)
    return Catalog(
        tuple(map(str, range(N))), rng.uniform(-1.2, 1.2, N), rng.uniform(-3.0, 3.0, N), major, 0.7 * major,
        rng.uniform(0.0, np.pi, N), np.zeros(N), BODY, MapErrors.zeros(N),
    )  # fmt: skip


def rim_points(catalog: Catalog, turn: float) -> np.ndarray:
    """Points (n, 3) of the rims in space, m."""
    x = np.cos(turn) * catalog.semi_major_m[:, None] * catalog.gRl[:, :, 0]
    y = np.sin(turn) * catalog.semi_minor_m[:, None] * catalog.gRl[:, :, 1]
    return catalog.centres + x + y


def test_rims_lie_on_the_ground_in_the_mean_around(catalog: Catalog) -> None:
    # Waves of 270 km: bent across their crests only.
    ground = Ground(lambda u: 500.0 + 300.0 * np.sin(40.0 * u @ [0.36, -0.48, 0.8]))
    found = with_rim_heights(catalog, ground)
    assert found.has_heights
    off = []
    for turn in np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False):
        points = rim_points(found, turn)
        radius = np.linalg.norm(points, axis=1)
        off.append(radius - BODY.radius_m - ground.heights_m(points / radius[:, None]))
    assert_allclose(np.mean(off, axis=0), 0.0, atol=0.5)


def test_slopes_leave_heights_sure_and_bends_do_not(catalog: Catalog) -> None:
    direction = np.array([0.36, 0.48, 0.8])
    _, sigma_m = along_rims(catalog, Ground(lambda u: 1e4 * u @ direction))
    assert (sigma_m < 0.01 * catalog.semi_major_m * 1e4 / BODY.radius_m).all()
    # A saddle of 100 m at the rim, on a slope: its heights are +-71 m, and a quarter as many count as points.
    one = catalog.take(np.array([5]))
    one = replace(one, semi_minor_m=one.semi_major_m)
    x, y = (BODY.radius_m / one.semi_major_m[0] * one.gRl[0, :, i] for i in (0, 1))
    saddle = Ground(lambda u: 100.0 * ((u @ x) ** 2 - (u @ y) ** 2) + 200.0 * (u @ x) - 90.0 * (u @ y))
    mean_m, sigma_m = along_rims(one, saddle)
    assert_allclose(mean_m, 0.0, atol=0.5)
    assert_allclose(sigma_m, 100.0 / np.sqrt(2.0) / 2.0, rtol=0.01)


def test_the_crest_that_a_coarse_model_smooths_away_is_added(catalog: Catalog) -> None:
    mean_radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    fine, half, coarse = (
        with_rim_heights(catalog, Ground(lambda u: np.zeros(len(u)), step_rad))
        for step_rad in (1e-7, 5e-3, 1e3)
    )
    assert coarse.errors is not None
    assert fine.errors is not None
    assert_allclose(coarse.height_m - fine.height_m, 0.021 * mean_radius_m, rtol=1e-3)
    assert_allclose(coarse.errors.height_m, 0.014 * mean_radius_m, rtol=1e-3)
    assert_allclose(fine.errors.height_m, 0.0, atol=1e-6)
    # Of larger craters a model shows a larger share.
    share = (half.height_m - fine.height_m) / (coarse.height_m - fine.height_m)
    assert (np.diff(share) < 0.0).all()
    assert 0.1 < share[-1] < share[0] < 1.0
    assert with_rim_heights(replace(catalog, errors=None), Ground(lambda u: u[:, 0])).errors is None


def test_a_rim_that_reaches_over_the_border_is_not_within(catalog: Catalog) -> None:
    """The border is a meridian; one crater of three reaches over it with an end of its major axis only."""
    three = catalog.take(np.array([0, 1, 2]))
    three = replace(
        three, latitude_rad=np.zeros(3), longitude_rad=np.array([0.03, 0.05, -0.03]), angle_rad=np.zeros(3),
        semi_major_m=np.full(3, 70e3), semi_minor_m=np.full(3, 20e3),
    )  # fmt: skip
    east = Ground(lambda u: 1e3 + 0.0 * u[:, 0], border=(0.0, 1.0, 0.0, 0.0))
    assert rims_within(three, east).tolist() == [False, True, False]
    upright = replace(three, angle_rad=np.full(3, 0.5 * np.pi))
    assert rims_within(upright, east).tolist() == [True, True, False]

    before = replace(three, height_m=np.array([1.0, 2.0, 3.0]), errors=MapErrors(*np.full((3, 3), 7.0)))
    found = with_covered_heights(before, east)
    assert found.errors is not None
    assert found.height_m[[0, 2]].tolist() == [1.0, 3.0]
    assert found.height_m[1] == with_rim_heights(before, east).height_m[1] != 2.0
    assert found.errors.height_m[[0, 2]].tolist() == [7.0, 7.0]
    assert found.errors.height_m[1] < 1.0
    west = replace(east, border=(0.0, 0.0, 0.0, 1.0))
    assert with_covered_heights(before, west) is before


def test_heights_beyond_a_model_are_as_unknown_as_the_ground_is_rough(catalog: Catalog) -> None:
    north = Ground(lambda u: 6e3 + 0.0 * u[:, 0], border=(0.0, 0.0, 1.0, 0.0))
    inside = rims_within(catalog, north)
    assert 0 < inside.sum() < N
    for height_m, expected_m in ((6e3, 6e3), (10.0, 1e-3 * BODY.radius_m)):
        on_ground = replace(catalog, height_m=np.where(inside, height_m, 0.0))
        shift = unknown_beyond(on_ground, north).common_shift
        assert shift is not None
        assert_allclose(shift.height_m[~inside], expected_m)
        assert np.isnan(shift.height_m[inside]).all()
    everywhere = replace(north, border=(0.0, 0.0, 0.0, 0.0))
    assert unknown_beyond(catalog, everywhere) is catalog


def test_heights_as_large_as_the_body_are_implausible(catalog: Catalog) -> None:
    for share, plausible in ((0.3, True), (-0.3, True), (0.5, False), (-0.5, False)):
        heights = np.zeros(N)
        heights[4] = share * BODY.radius_m
        assert (implausible_heights(replace(catalog, height_m=heights)) is None) == plausible
