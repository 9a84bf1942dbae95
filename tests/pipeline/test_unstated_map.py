"""A catalogue that states no errors and has some: the rims tell, unless something else explains them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.instruments import RIMS
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.pipeline import unstated_map
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.resection.estimated_errors import EstimatedErrors
from craternav_fg.resection.map_variances import estimated_errors
from craternav_fg.runs.write import write_run
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from tests.foreign.files import write
from tests.foreign.worlds import draw_world

PLACE_M, SIZE_SHARE, HEIGHT_M = 20.0, 0.01, 30.0


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A descent with measured rims over an exact catalogue."""
    return Dataset.open(simulate(load_scenario("measured_descent"), tmp_path_factory.mktemp("many") / "d"))


def moved(true: Catalog, place_m: float = 0.0, size_share: float = 0.0, height_m: float = 0.0) -> Catalog:
    """Errors in all craters of a catalogue that states none."""
    rng, n = np.random.default_rng(3), len(true)
    north, east = place_m / true.body.radius_m * rng.normal(size=(2, n))
    return replace(
        true,
        latitude_rad=true.latitude_rad + north,
        longitude_rad=true.longitude_rad + east / np.cos(true.latitude_rad),
        semi_major_m=true.semi_major_m * (1.0 + size_share * rng.normal(size=n)),
        semi_minor_m=true.semi_minor_m * (1.0 + size_share * rng.normal(size=n)),
        height_m=true.height_m + height_m * rng.normal(size=n),
        errors=None,
    )


def estimated(data: Dataset, catalog: Catalog) -> EstimatedErrors | None:
    assert data.measurements is not None
    assert data.truth is not None
    rows = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    return estimated_errors(data.measurements, data.truth.gTb[rows], data.camera, catalog)


@pytest.mark.parametrize(
    ("name", "size"), [("place_m", PLACE_M), ("size_share", SIZE_SHARE), ("height_m", HEIGHT_M)]
)
def test_each_kind_of_error_is_told_from_the_others(data: Dataset, name: str, size: float) -> None:
    found = estimated(data, moved(data.catalog, **{name: size}))
    assert found is not None
    errors = found.of(data.catalog)
    for other, full in (("place_m", PLACE_M), ("size_share", SIZE_SHARE), ("height_m", HEIGHT_M)):
        median = float(np.median(getattr(errors, other)))
        assert (median == pytest.approx(size, rel=0.35)) if other == name else (median < 0.2 * full)


def test_poses_from_elsewhere_lead_to_the_same(data: Dataset) -> None:
    """Each image has a pose of its own: what led to the one nearby does not matter."""
    assert data.measurements is not None
    assert data.truth is not None
    catalog = moved(data.catalog, PLACE_M)
    rows = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    off = data.truth.gTb[rows].copy()
    off[:, :3, 3] += [2000.0, -1000.0, 2000.0]
    off[:, :3, :3] = off[:, :3, :3] @ frames.rotation_exp(np.radians([3.0, -2.0, 5.0]))
    found, near = estimated_errors(data.measurements, off, data.camera, catalog), estimated(data, catalog)
    assert found is not None
    assert near is not None
    for one in ("place_m", "size_share", "height_m"):
        expected = np.median(getattr(near.of(catalog), one))
        assert np.median(getattr(found.of(catalog), one)) == pytest.approx(expected, rel=0.02, abs=0.02)


def test_an_exact_map_and_noise_that_is_stated_too_small_are_no_errors_of_the_map(data: Dataset) -> None:
    assert estimated(data, replace(data.catalog, errors=None)) is None
    assert data.measurements is not None
    halved = tuple(
        replace(one, rims=replace(one.rims, covariance=0.25 * one.rims.covariance))
        for one in data.measurements
    )
    assert estimated(replace(data, measurements=halved), replace(data.catalog, errors=None)) is None


def test_wrong_matches_are_no_errors_of_the_map(data: Dataset) -> None:
    """A third of the rims are those of other craters."""
    assert data.measurements is not None
    rng = np.random.default_rng(5)
    matched = []
    for one in data.measurements:
        charts, wrong = one.rims.chart.copy(), np.flatnonzero(rng.random(len(one.rims)) < 0.33)
        charts[wrong, :2] = rng.uniform(-0.3, 0.3, size=(len(wrong), 2))
        matched.append(replace(one, rims=replace(one.rims, chart=charts)))
    wrong_matches = replace(data, measurements=tuple(matched))
    spurious = estimated(wrong_matches, replace(data.catalog, errors=None))
    assert spurious is None or np.median(spurious.of(data.catalog).place_m) < 0.1 * PLACE_M
    found = estimated(wrong_matches, moved(data.catalog, PLACE_M))
    assert found is not None
    assert np.median(found.of(data.catalog).place_m) == pytest.approx(PLACE_M, rel=0.35)


def test_few_rims_tell_nothing(data: Dataset) -> None:
    assert data.measurements is not None
    few = tuple(
        replace(one, rims=one.rims.take(np.arange(min(2, len(one.rims))))) for one in data.measurements
    )
    assert estimated(replace(data, measurements=few), moved(data.catalog, PLACE_M)) is None


def test_covariances_hold_the_errors_that_the_rims_show(data: Dataset, tmp_path: Path) -> None:
    """Taken as exact, this map gave an ANEES of hundreds and more."""
    wrong = replace(data, catalog=moved(data.catalog, PLACE_M, SIZE_SHARE, HEIGHT_M))
    run = reconstruct(wrong, ["smoother", "online", "ekf"])
    assert run.map_errors is not None
    (text,) = (one for one in run.warnings if "contradict it at every pose" in one)
    assert run.map_errors.words in text
    assert data.truth is not None
    for name, trajectory in run.trajectories.items():
        found = metrics(trajectory, data.truth)
        assert found.anees is not None, name
        assert found.anees < 15.0, name
    summary = write_run(tmp_path, run, dataset="", truth=None, times_s={}, wall_s=0.0)
    assert summary["assumed_map_errors"]["height_m"] == run.map_errors.height_m


def test_a_height_error_that_all_have_in_common_is_in_the_covariance(data: Dataset) -> None:
    """Heights in feet: the rims show how they scatter, not that all are too high. ANEES was 233, 136, 68."""
    feet = replace(data.catalog, height_m=data.catalog.height_m / 0.3048, errors=None)
    run = reconstruct(replace(data, catalog=feet), ["smoother", "online", "ekf"])
    assert run.map_errors is not None
    assert run.map_errors.height_m > 30.0
    (text,) = (one for one in run.warnings if "contradict it at every pose" in one)
    assert "as much of all heights together" in text
    assert data.truth is not None
    for name, trajectory in run.trajectories.items():
        anees = metrics(trajectory, data.truth).anees
        assert anees is not None
        assert anees < 20.0, name


def test_what_is_known_of_the_common_height_stays(data: Dataset) -> None:
    errors, n = EstimatedErrors(0.0, 0.0, 0.0, 30.0, 0.0, 0.0), len(data.catalog)
    catalog = replace(data.catalog, common_shift=None)
    assumed = errors.common_shift(catalog)
    assert assumed is not None
    np.testing.assert_array_equal(assumed.height_m, 30.0)
    assert np.isnan(assumed.place_m).all()
    stated = CommonShift(np.full(n, 50.0), np.full(n, 2.0), np.zeros(n, dtype=np.int64))
    again = errors.common_shift(replace(catalog, common_shift=stated))
    assert again is not None
    np.testing.assert_array_equal([again.place_m, again.height_m], [stated.place_m, stated.height_m])
    # Unknown heights are in the covariance with more than that.
    assert errors.common_shift(replace(catalog, has_heights=False)) is None
    assert EstimatedErrors(30.0, 0.0, 0.01, 0.0, 0.0, 0.0).common_shift(catalog) is None


def test_images_are_measured_again_with_the_errors_that_they_show(tmp_path: Path) -> None:
    """On ground of another renderer: as exact, rims are not found, and the rest is believed."""
    exact = Dataset.open(write(draw_world(1, "gentle"), tmp_path / "d", 1))
    assert reconstruct(exact, ["ekf"]).map_errors is None
    wrong = replace(exact, catalog=moved(exact.catalog, 15.0))
    said: set[str] = set()
    run = reconstruct(wrong, ["ekf"], progress=lambda what, done, total: said.add(what))
    assert run.map_errors is not None
    assert np.median(run.map_errors.of(wrong.catalog).place_m) == pytest.approx(15.0, rel=0.4)
    assert "frames again, with the map's errors" in said
    zeros = replace(wrong, catalog=replace(wrong.catalog, errors=MapErrors.zeros(len(wrong.catalog))))
    believed = reconstruct(zeros, ["ekf"])
    assert believed.map_errors is None
    rims, fewer = (sum(len(frame.rims) for frame in one.frames) for one in (run, believed))
    assert rims > 1.2 * fewer
    assert exact.truth is not None
    anees = [metrics(one.trajectories["ekf"], exact.truth).anees for one in (run, believed)]
    assert anees[0] is not None
    assert anees[1] is not None
    assert anees[0] < 12.0
    assert anees[1] > 50.0


def test_the_estimate_does_not_depend_on_the_estimators(data: Dataset) -> None:
    wrong = replace(data, catalog=moved(data.catalog, PLACE_M))
    runs = [reconstruct(wrong, [name]).map_errors for name in ("ekf", "dead_reckoning")]
    assert runs[0] == runs[1]
    assert runs[0] is not None


def test_what_is_stated_or_explained_otherwise_is_left_alone(data: Dataset) -> None:
    exact = MapErrors.zeros(len(data.catalog))
    stated = replace(moved(data.catalog, PLACE_M), errors=exact)
    assert reconstruct(replace(data, catalog=stated), ["ekf"]).map_errors is None
    assert reconstruct(data, ["ekf"]).map_errors is None
    unseen = replace(data, catalog=moved(data.catalog, PLACE_M))
    assert reconstruct(unseen, ["dead_reckoning"], without=[RIMS]).map_errors is None
    assert data.measurements is not None
    doubled = tuple(
        replace(one, rims=replace(one.rims, chart=one.rims.chart + np.log(2.0) * np.array([0, 0, 1, 0, 1])))
        for one in data.measurements
    )
    run = reconstruct(replace(data, measurements=doubled), ["ekf"])
    assert run.map_errors is None
    assert any("diameters for semi-axes" in text for text in run.warnings)


def test_a_crater_under_the_name_of_another_is_named(data: Dataset) -> None:
    """In all of its frames: no frame alone tells, but the others agree without it."""
    assert data.measurements is not None
    every = np.concatenate([one.rims.craters for one in data.measurements])
    rows, counts = np.unique(every, return_counts=True)
    wrong = int(rows[np.argmax(counts)])
    other = next(row for row in range(len(data.catalog)) if row not in rows)
    renamed = tuple(
        replace(
            one, rims=replace(one.rims, craters=np.where(one.rims.craters == wrong, other, one.rims.craters))
        )
        for one in data.measurements
    )
    run = reconstruct(replace(data, measurements=renamed), ["smoother"])
    (text,) = (one for one in run.warnings if "where the others agree" in one)
    assert f"rims of {data.catalog.identifiers[other]} ({counts.max()} frames) are outliers" in text
    assert run.map_errors is None
    exact = reconstruct(data, ["smoother"])
    assert not exact.wrong_craters
    assert data.truth is not None
    rms_m = [metrics(one.trajectories["smoother"], data.truth).position_rms_m for one in (run, exact)]
    assert rms_m[0] < 1.5 * rms_m[1]


def test_a_measurement_that_fails_with_the_errors_leaves_the_first(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise EstimationError("no start")

    monkeypatch.setattr(unstated_map, "_again", fails)
    run = reconstruct(replace(data, catalog=moved(data.catalog, PLACE_M)), ["ekf"])
    assert run.map_errors is None
    assert any("counts as exact" in text for text in run.warnings)


def test_words() -> None:
    errors = EstimatedErrors(123.4, 0.02, 0.0, 4.0, 0.003, 0.0)
    assert errors.words == "places 123 m and 2 % of the radius per axis, heights 4 m and 0.3 % of the radius"
    assert EstimatedErrors(0.0, 0.0, 0.011, 0.0, 0.0, 0.0).words == "semi-axes 1.1 %"
    assert EstimatedErrors(*[0.0] * 5, 0.061).words == "slopes of planes 0.061 rad"
    assert errors.scaled(2.0).exceed(errors, 1.9)
    assert not errors.exceed(errors, 1.01)
    assert not EstimatedErrors(0.01, *[0.0] * 5).exceed(EstimatedErrors(1e-9, *[0.0] * 5), 1.1)
    assert EstimatedErrors(*[0.0] * 5, 0.06).exceed(EstimatedErrors(*[0.0] * 5, 0.04), 1.2)
