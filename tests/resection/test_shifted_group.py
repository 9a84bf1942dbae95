"""Half of a catalogue that is displaced alike is told from independent errors, and aligned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.resection import map_variances
from craternav_fg.resection.map_variances import estimated_errors, place_equations
from craternav_fg.resection.shifted_group import ShiftedGroup, shifted_group
from craternav_fg.runs.write import write_run
from craternav_fg.simulation.scenario import simulate
from factors.arrays import BoolArray, IntArray

SAID = "are displaced alike against the others"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate("measured_descent", tmp_path_factory.mktemp("groups") / "data"))


def moved(true: Catalog, east_m: float, north_m: float, group: BoolArray, place_m: float) -> Catalog:
    """A group's places off alike, those of all craters by independent errors."""
    off = place_m * np.random.default_rng(7).normal(size=(2, len(true)))
    east, north = (off + np.outer([east_m, north_m], group)) / true.body.radius_m
    return replace(
        true,
        latitude_rad=true.latitude_rad + north,
        longitude_rad=true.longitude_rad + east / np.cos(true.latitude_rad),
        errors=None,
    )


def halves(catalog: Catalog) -> dict[str, BoolArray]:
    return {
        "east": catalog.longitude_rad > np.median(catalog.longitude_rad),
        "second": np.arange(len(catalog)) % 2 == 1,
    }


def found(data: Dataset, catalog: Catalog) -> tuple[ShiftedGroup | None, IntArray]:
    """By rims alone, from poses some way off; with the craters that were asked."""
    assert data.measurements is not None
    assert data.truth is not None
    at = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    gTb = data.truth.gTb[at].copy()
    gTb[:, :3, 3] += [100.0, -200.0, 50.0]
    errors = estimated_errors(data.measurements, gTb, data.camera, catalog)
    equations = place_equations(data.measurements, gTb, data.camera, catalog, errors)
    if equations is None:
        return None, np.empty(0, np.int64)
    return shifted_group(equations, catalog), equations.craters


@pytest.mark.parametrize("half", ["east", "second"])
@pytest.mark.parametrize(("shift_m", "place_m"), [(50.0, 0.0), (300.0, 20.0)])
def test_a_group_is_found(data: Dataset, half: str, shift_m: float, place_m: float) -> None:
    group = halves(data.catalog)[half]
    one, seen = found(data, moved(data.catalog, 0.6 * shift_m, -0.8 * shift_m, group, place_m))
    assert one is not None
    named = np.isin(seen, one.rows)
    assert named.sum() == one.seen
    assert len(seen) == one.of
    right = float(np.mean(named == group[seen]))
    # The smaller half is named, whichever was moved.
    assert max(right, 1.0 - right) > 0.95
    sign = 1.0 if right > 0.5 else -1.0
    shift = sign * np.array([one.east_m, one.north_m])
    np.testing.assert_allclose(shift, [0.6 * shift_m, -0.8 * shift_m], atol=0.15 * shift_m)
    assert one.shift_m == pytest.approx(np.hypot(*shift))


@pytest.mark.parametrize("place_m", [0.0, 20.0, 100.0])
def test_independent_errors_are_no_group(data: Dataset, place_m: float) -> None:
    catalog = data.catalog
    assert found(data, moved(catalog, 0.0, 0.0, halves(catalog)["east"], place_m))[0] is None


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_wrong_matches_are_no_group(data: Dataset, share: float) -> None:
    assert data.measurements is not None
    rng = np.random.default_rng(6)
    frames = []
    for frame in data.measurements:
        charts, wrong = frame.rims.chart.copy(), rng.random(len(frame.rims)) < share
        charts[wrong, :2] = rng.uniform(-0.3, 0.3, size=(np.count_nonzero(wrong), 2))
        frames.append(replace(frame, rims=replace(frame.rims, chart=charts)))
    assert found(replace(data, measurements=tuple(frames)), data.catalog)[0] is None


def test_a_trend_is_no_group(data: Dataset) -> None:
    """The places of another scale, or about another pole."""
    catalog, middle = data.catalog, float(data.catalog.longitude_rad.mean())
    scaled = middle + 1.01 * (catalog.longitude_rad - middle)
    assert found(data, replace(catalog, longitude_rad=scaled))[0] is None
    turned = catalog.latitude_rad + 0.01 * (catalog.longitude_rad - middle)
    assert found(data, replace(catalog, latitude_rad=turned))[0] is None


def test_of_many_craters_those_that_most_images_show_are_asked(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_variances, "_MOST_DISPLACED", 40)
    catalog = moved(data.catalog, 30.0, -40.0, halves(data.catalog)["east"], 0.0)
    one, seen = found(data, catalog)
    assert data.measurements is not None
    counts = np.bincount(np.concatenate([frame.rims.craters for frame in data.measurements]))
    assert len(seen) == 40
    assert counts[seen].min() >= np.delete(counts, seen).max()
    assert one is not None
    assert one.shift_m == pytest.approx(50.0, rel=0.15)


def test_few_craters_tell_nothing(data: Dataset) -> None:
    assert data.measurements is not None
    assert data.truth is not None
    some = data.measurements[:3]
    at = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in some])
    catalog = moved(data.catalog, 300.0, 0.0, halves(data.catalog)["second"], 0.0)
    equations = place_equations(some, data.truth.gTb[at], data.camera, catalog, None)
    assert equations is not None
    assert shifted_group(equations, catalog) is None
    assert place_equations([], data.truth.gTb[:0], data.camera, catalog, None) is None


@pytest.mark.parametrize("half", ["east", "second"])
def test_a_descent_over_such_a_catalogue(data: Dataset, tmp_path: Path, half: str) -> None:
    """As it was, the ANEES of the smoother was 3e4 and 100."""
    catalog = moved(data.catalog, 240.0, 180.0, halves(data.catalog)[half], 20.0)
    run = reconstruct(replace(data, catalog=catalog), ["smoother", "ekf"])
    assert run.shifted_group is not None
    (text,) = (one for one in run.warnings if SAID in one)
    assert f"{run.shifted_group.seen} of {run.shifted_group.of} craters" in text
    assert f"by {run.shifted_group.shift_m:.3g} m" in text
    for name, trajectory in run.trajectories.items():
        one = metrics(trajectory, data.truth)
        assert one.anees is not None
        assert one.anees < 15.0, name
        # Half of the shift is in the covariance.
        assert one.position_rms_m < 200.0
    told = write_run(tmp_path, run, dataset="", truth=None, times_s={}, wall_s=0.0)["shifted_craters"]
    assert len(told["craters"]) == len(run.shifted_group.rows)
    assert np.hypot(told["east_m"], told["north_m"]) == pytest.approx(run.shifted_group.shift_m)


def test_right_maps_and_stated_shifts_are_left_alone(data: Dataset) -> None:
    run = reconstruct(data, ["ekf"])
    assert run.shifted_group is None
    assert not any(SAID in one for one in run.warnings)
    catalog = moved(data.catalog, 240.0, 180.0, halves(data.catalog)["second"], 0.0)
    group = ShiftedGroup(np.array([0]), 1, 2, 240.0, 180.0)
    stated = replace(catalog, common_shift=group.aligned(catalog).common_shift)
    assert reconstruct(replace(data, catalog=stated), ["ekf"]).shifted_group is None


@pytest.mark.parametrize("stated_share", [0.0, 0.05])
def test_wrong_sizes_are_no_group(data: Dataset, stated_share: float) -> None:
    catalog, every = data.catalog, np.ones(len(data.catalog))
    factor = np.exp(0.05 * np.random.default_rng(3).normal(size=len(catalog)))
    resized = replace(
        catalog,
        semi_major_m=factor * catalog.semi_major_m,
        semi_minor_m=factor * catalog.semi_minor_m,
        errors=MapErrors(0.0 * every, stated_share * every, 0.0 * every),
    )
    assert reconstruct(replace(data, catalog=resized), ["ekf"]).shifted_group is None


def test_both_parts_meet_in_the_middle(data: Dataset) -> None:
    group = halves(data.catalog)["east"]
    catalog = moved(data.catalog, 30.0, -40.0, group, 0.0)
    aligned = ShiftedGroup(np.flatnonzero(group), 3, 6, 30.0, -40.0).aligned(catalog)
    middle = moved(data.catalog, 15.0, -20.0, np.ones_like(group), 0.0)
    # Places are moved at the height of the rims, on this body's scale.
    np.testing.assert_allclose(aligned.centres, middle.centres, atol=0.2)
    assert aligned.common_shift is not None
    np.testing.assert_allclose(aligned.common_shift.place_m, 25.0)
