"""A map that is shifted as a whole: the trajectory moves with it, and its covariance says so."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import ArcSet, RimSet
from craternav_fg.pipeline.map_shift import common_covariance
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from factors.arrays import FloatArray
from tests.descents import scenario

ESTIMATORS = ["smoother", "online", "fixed_lag", "ekf"]
PLACE_M, HEIGHT_M, TRIALS = 150.0, 100.0, 12


def shifted(catalog: Catalog, turn_rad: FloatArray, height_m: float) -> Catalog:
    """Turn all craters about the body's centre, and raise them."""
    centres = catalog.centres @ frames.rotation_exp(turn_rad).T
    latitude, longitude = frames.latitude_longitude(centres)
    return replace(
        catalog, latitude_rad=latitude, longitude_rad=longitude, height_m=catalog.height_m + height_m
    )


def a_shift(rng: np.random.Generator, catalog: Catalog) -> tuple[FloatArray, float]:
    """Draw a turn and a height: shifts of `PLACE_M` per axis along the ground at the craters."""
    east, north, up = frames.east_north_up(catalog.latitude_rad[:1], catalog.longitude_rad[:1])[0].T
    along = PLACE_M * (rng.standard_normal() * east + rng.standard_normal() * north)
    return np.cross(up, along) / catalog.body.radius_m, HEIGHT_M * float(rng.standard_normal())


def test_errors_of_a_map_with_a_common_shift_agree_with_their_covariances(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    case = scenario(duration_s=30.0)
    stated: dict[str, list[float]] = {name: [] for name in ESTIMATORS}
    unstated: dict[str, list[float]] = {name: [] for name in ESTIMATORS}
    for trial in range(TRIALS):
        data = Dataset.open(simulate(case, tmp_path / f"{trial}", trial=trial))
        moved = shifted(data.catalog, *a_shift(rng, data.catalog))
        told = replace(moved, common_shift=CommonShift.of_source(len(moved), PLACE_M, HEIGHT_M))
        # A few trials are enough to see that the covariances are far too small.
        for catalog, out in ((told, stated), (moved, unstated))[: 2 if trial < 5 else 1]:
            found = reconstruct(replace(data, catalog=catalog), ESTIMATORS)
            for name, one in found.trajectories.items():
                assert one.pose_covariance is not None
                out[name].append(float(nees(errors(one, data.truth).pose, one.pose_covariance)[-1]))
    low, high = chi2.ppf([0.001, 0.999], 6 * TRIALS) / TRIALS
    for name in ESTIMATORS:
        assert low < np.mean(stated[name]) < high, name
        assert np.mean(unstated[name]) > 2.0 * high, name


def test_the_pose_moves_with_the_map_as_its_covariance_says(tmp_path: Path) -> None:
    """Unit shifts give poses whose differences are the columns of the covariance's root."""
    data = Dataset.open(simulate(scenario(duration_s=6.0), tmp_path / "d"))
    before = reconstruct(data, ["smoother"]).trajectories["smoother"]
    gTb = before.gTb[-1]
    up = gTb[:3, 3] / np.linalg.norm(gTb[:3, 3])
    east = np.cross([0.0, 0.0, 1.0], up) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], up))
    total = np.zeros((6, 6))
    for turn, height_m in (
        (np.cross(up, PLACE_M * east) / data.body.radius_m, 0.0),
        (np.cross(up, PLACE_M * np.cross(up, east)) / data.body.radius_m, 0.0),
        (np.zeros(3), HEIGHT_M),
    ):
        moved = replace(data, catalog=shifted(data.catalog, turn, height_m))
        after = reconstruct(moved, ["smoother"]).trajectories["smoother"].gTb[-1]
        step = np.concatenate([frames.rotation_log(gTb[:3, :3].T @ after[:3, :3]), after[:3, 3] - gTb[:3, 3]])
        total += np.outer(step, step)
    stated = replace(data.catalog, common_shift=CommonShift.of_source(len(data.catalog), PLACE_M, HEIGHT_M))
    assert data.measurements is not None
    expected = common_covariance(before, stated, data.measurements)[-1]
    np.testing.assert_allclose(expected[3:, 3:], total[3:, 3:], atol=0.02 * PLACE_M**2)
    np.testing.assert_allclose(expected[:3, :3], total[:3, :3], atol=0.05 * np.diag(expected)[:3].max())


def test_craters_of_another_source_count_by_what_they_contribute(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=6.0), tmp_path / "d"))
    truth, measured = data.truth, data.measurements
    assert truth is not None
    assert measured is not None

    def sigma_m(exact: Callable[[int], bool]) -> float:
        places = np.array([0.0 if exact(row) else PLACE_M for row in range(len(data.catalog))])
        source = np.where(places > 0.0, 0, 1)
        catalog = replace(data.catalog, common_shift=CommonShift(places, 0.0 * places, source))
        return float(np.sqrt(np.trace(common_covariance(truth, catalog, measured)[-1, 3:, 3:])))

    seen = np.unique(np.concatenate([frame.rims.craters for frame in measured]))
    whole = sigma_m(lambda row: False)
    assert 0.0 < sigma_m(lambda row: row == seen[0]) < whole
    assert sigma_m(lambda row: row in seen) == 0.0


def test_arcs_bring_the_common_shift_of_their_craters(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=2.0), tmp_path / "d"))
    truth, measured = data.truth, data.measurements
    assert truth is not None
    assert measured is not None
    of_arcs = []
    for frame in measured:
        rims = frame.rims
        points = tuple(chart[:2] + np.zeros((4, 2)) for chart in rims.chart)
        arcs = ArcSet(rims.craters, points, tuple(np.full(4, 1e-3) for _ in points))
        of_arcs.append(replace(frame, rims=RimSet.empty(), arcs=arcs))
    catalog = replace(data.catalog, common_shift=CommonShift.of_source(len(data.catalog), PLACE_M, HEIGHT_M))
    whole, seen = (common_covariance(truth, catalog, frames) for frames in (measured, of_arcs))
    assert whole.any()
    np.testing.assert_allclose(seen, whole)


def test_dead_reckoning_and_unstated_shifts_change_nothing(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=6.0), tmp_path / "d"))
    told = replace(data.catalog, common_shift=CommonShift.of_source(len(data.catalog), PLACE_M, HEIGHT_M))
    names = ["ekf", "dead_reckoning"]
    before, after = (reconstruct(replace(data, catalog=one), names) for one in (data.catalog, told))
    for name, same in (("ekf", False), ("dead_reckoning", True)):
        one, other = before.trajectories[name], after.trajectories[name]
        np.testing.assert_array_equal(one.gTb, other.gTb)
        assert np.array_equal(one.pose_covariance, other.pose_covariance) is same
    assert CommonShift.of_source(3, 0.0, 0.0) is None


def test_shifts_of_sources_combine_by_weight() -> None:
    shift = CommonShift(np.array([30.0, 40.0]), np.array([5.0, 0.0]), np.array([1, 2]))
    assert shift.take(np.array([1])).place_m.tolist() == [40.0]
    both = CommonShift.joined([shift, CommonShift.zeros(1)])
    assert both.place_m.tolist() == [30.0, 40.0, 0.0]
    assert both.of_mean(np.array([0.0, 1.0, 1.0])) == pytest.approx((20.0, 0.0))
    assert both.of_mean(np.array([1.0, 1.0, 0.0])) == pytest.approx((25.0, 2.5))
    assert both.of_mean(np.zeros(3)) == (0.0, 0.0)
    # Independent sources of equal sigmas average, one source does not, whatever its values.
    equal = replace(shift, place_m=np.array([30.0, 30.0]))
    assert equal.of_mean(np.ones(2))[0] == pytest.approx(30.0 / np.sqrt(2.0))
    one = replace(shift, source=np.zeros(2, dtype=np.int64))
    assert one.of_mean(np.ones(2)) == pytest.approx((35.0, 2.5))


def test_a_small_shift_of_the_catalogue_is_in_the_distance_from_the_initial_position(tmp_path: Path) -> None:
    """All else agrees with a trajectory that is 3 km off, so a single descent cannot tell it."""
    data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / "d"))
    turned = replace(data.catalog, longitude_rad=data.catalog.longitude_rad + np.radians(0.1))
    east = []
    for one in (data, replace(data, catalog=turned)):
        result = reconstruct(one, ["smoother"])
        assert result.initial_position is not None
        text = result.initial_position["smoothed"]
        degrees = float(text.split("(")[1].split(" deg")[0])
        east.append(degrees if "to the east" in text else -degrees)
        assert result.initial_position["sigmas"] < 4.0
    assert reconstruct(data, ["ekf"]).initial_position is None
    assert east[1] - east[0] == pytest.approx(0.1, abs=0.01)
