"""Rims' planes that slope, and a catalogue that does not say so: the shapes of the rims tell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.campaign.run import as_measured
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline import unstated_map
from craternav_fg.pipeline.map_errors import with_tilts
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.resection.estimated_errors import EstimatedErrors
from craternav_fg.resection.map_variances import estimated_errors
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims
from tests.foreign.files import write
from tests.foreign.worlds import draw_world

TILT_RAD = 0.1


@pytest.fixture(scope="module")
def level(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A descent with measured rims, over level planes whose slopes the catalogue does not state."""
    case = as_measured(load_scenario("bennu_descent"), images=False)
    data = Dataset.open(simulate(case, tmp_path_factory.mktemp("slopes") / "d", trial=1))
    return replace(data, catalog=replace(data.catalog, plane_tilt_rad=None))


def poses(data: Dataset) -> FloatArray:
    assert data.measurements is not None
    assert data.truth is not None
    rows = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    return np.asarray(data.truth.gTb[rows])


def charts_of(data: Dataset, catalog: Catalog, frame: FrameMeasurement, pose: FloatArray) -> FloatArray:
    rows, gTb = frame.rims.craters, np.ascontiguousarray(pose)
    charts, seen = project_rims(gTb, data.camera.bTc, catalog.centres[rows], catalog.axes[rows])
    assert seen.all()
    return np.asarray(charts)


def tilted(data: Dataset, sigma_rad: float) -> Dataset:
    """The same with rims of planes that slope."""
    assert data.measurements is not None
    # With these numbers, rims on level planes contradict the camera's intrinsics.
    slopes = sigma_rad * np.random.default_rng(101).normal(size=(len(data.catalog), 2))
    true = replace(data.catalog, plane_tilt_rad=slopes)
    moved = tuple(
        replace(
            frame,
            rims=replace(
                frame.rims,
                chart=frame.rims.chart
                + charts_of(data, true, frame, pose)
                - charts_of(data, data.catalog, frame, pose),
            ),
        )
        for frame, pose in zip(data.measurements, poses(data), strict=True)
    )
    return replace(data, measurements=moved)


def estimated(data: Dataset) -> EstimatedErrors | None:
    assert data.measurements is not None
    return estimated_errors(data.measurements, poses(data), data.camera, data.catalog)


def test_slopes_are_told_from_other_errors(level: Dataset) -> None:
    assert estimated(level) is None
    found = estimated(tilted(level, 0.03))
    assert found is not None
    assert found.tilt_rad == pytest.approx(0.03, rel=0.25)
    assert found.size_share < 0.005
    assert np.median(found.of(level.catalog).place_m / level.catalog.semi_major_m) < 0.005


def test_other_errors_are_no_slopes(level: Dataset) -> None:
    north, east = (
        0.05 * level.catalog.semi_major_m * np.random.default_rng(6).normal(size=(2, len(level.catalog)))
    )
    moved = replace(
        level.catalog,
        latitude_rad=level.catalog.latitude_rad + north / level.body.radius_m,
        longitude_rad=level.catalog.longitude_rad
        + east / level.body.radius_m / np.cos(level.catalog.latitude_rad),
    )
    found = estimated(replace(level, catalog=moved))
    assert found is not None
    assert found.tilt_rad == 0.0
    assert found.place_share == pytest.approx(0.05, rel=0.3)


def test_stated_slopes_are_not_estimated(level: Dataset) -> None:
    """What contradicts them is something else."""
    stated = replace(level.catalog, plane_tilt_rad=np.zeros((len(level.catalog), 2)))
    found = estimated(replace(tilted(level, TILT_RAD), catalog=stated))
    assert found is None or found.tilt_rad == 0.0


def test_covariances_hold_slopes_that_the_rims_show(level: Dataset) -> None:
    """As level, these planes gave an ANEES of 20 to 90, and the camera was blamed."""
    run = reconstruct(tilted(level, TILT_RAD), ["smoother", "online", "ekf"])
    assert run.map_errors is not None
    assert run.map_errors.tilt_rad == pytest.approx(TILT_RAD, rel=0.25)
    (text,) = (one for one in run.warnings if "contradict it at every pose" in one)
    assert "slopes of planes 0.1" in text
    assert "PLANE_TILT_EAST_DEG" in text
    assert not any("intrinsics: check" in one for one in run.warnings)
    assert level.measurements is not None
    assert level.truth is not None
    tilts = with_tilts(level.measurements, poses(level), level.camera, level.catalog, run.map_errors.tilt_rad)
    for frame, expected in zip(run.frames, tilts, strict=True):
        if len(frame.rims):
            assert frame.rims.of_map is not None
            assert expected.rims.of_map is not None
            found_tilts, size = frame.rims.of_map[:, :, -2:], np.abs(expected.rims.of_map).max()
            np.testing.assert_allclose(found_tilts, expected.rims.of_map, rtol=0.0, atol=0.02 * size)
    for name, trajectory in run.trajectories.items():
        found = metrics(trajectory, level.truth)
        assert found.anees is not None, name
        assert found.anees < 10.0, name
        assert found.position_rms_m < 0.1, name


def test_a_wrong_focal_length_is_no_slope(level: Dataset) -> None:
    """Not even where planes slope as well: nothing is assumed, and other warnings remain."""
    for data in (level, tilted(level, TILT_RAD)):
        assert data.measurements is not None
        longer = tuple(
            replace(
                one,
                rims=replace(
                    one.rims,
                    chart=one.rims.chart * [1.03, 1.03, 1.0, 1.0, 1.0]
                    + np.log(1.03) * np.array([0, 0, 1, 0, 1]),
                ),
            )
            for one in data.measurements
        )
        run = reconstruct(replace(data, measurements=longer), ["ekf"])
        assert run.map_errors is None
        assert any("contradicts what ekf predicts" in one for one in run.warnings)


def test_slopes_add_to_those_that_rims_hold(level: Dataset) -> None:
    assert level.measurements is not None
    gTb = poses(level)[:3]
    once = with_tilts(level.measurements[:3], gTb, level.camera, level.catalog, 0.03)
    both = with_tilts(once, gTb, level.camera, level.catalog, 0.04)
    straight = with_tilts(level.measurements[:3], gTb, level.camera, level.catalog, 0.05)
    for one, two, plain in zip(both, straight, level.measurements, strict=False):
        assert one.rims.of_map is not None
        assert two.rims.of_map is not None
        np.testing.assert_allclose(one.rims.of_map, two.rims.of_map, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(one.rims.covariance, two.rims.covariance, rtol=1e-9)
        white, before = (rims.uncorrelated_covariance for rims in (one.rims, plain.rims))
        np.testing.assert_allclose(white, before, rtol=1e-6, atol=1e-6 * before.max())


def test_images_are_measured_again_with_the_slopes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = Dataset.open(write(draw_world(1, "gentle"), tmp_path / "d", 1))
    told = iter(
        [EstimatedErrors(1.0, 0.0, 0.0, 1.0, 0.0, 0.08), EstimatedErrors(1.0, 0.0, 0.0, 1.0, 0.0, 0.0)]
    )
    monkeypatch.setattr(unstated_map, "_estimated", lambda *_: next(told, None))
    run = reconstruct(data, ["ekf"])
    usual = GuidedOptions().correlated_errors.map_tilt_rad
    used = run.options["front_end"]["correlated_errors"]["map_tilt_rad"]
    assert used == pytest.approx(np.hypot(usual, 0.08))
    assert run.map_errors is not None
    assert run.map_errors.tilt_rad == 0.08
