"""Errors that the catalogue states count for rims of another program, too."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import pixel_chart, points_and_normals
from craternav_fg.errors import EstimationError
from craternav_fg.evaluation.metrics import metrics
from craternav_fg.measurements import ArcSet
from craternav_fg.pipeline import map_errors
from craternav_fg.pipeline.map_errors import lack_map_errors
from craternav_fg.pipeline.measuring import Measuring
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.simulation.scenario import simulate
from craternav_fg.vision.guided_options import GuidedOptions
from factors.kernels.conic import project_rims
from tests.descents import scenario

PLACE_M, SIZE_SHARE, HEIGHT_M = 20.0, 0.005, 8.0


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A descent over a catalogue without errors."""
    return Dataset.open(simulate(scenario(duration_s=60.0), tmp_path_factory.mktemp("few") / "d"))


@pytest.fixture(scope="module")
def data(exact: Dataset) -> Dataset:
    """The same with a catalogue that is wrong by what it states, of which the rims do not know."""
    true, rng = exact.catalog, np.random.default_rng(3)
    n = len(true)
    north, east = PLACE_M / true.body.radius_m * rng.normal(size=(2, n))
    stated = replace(
        true,
        latitude_rad=true.latitude_rad + north,
        longitude_rad=true.longitude_rad + east / np.cos(true.latitude_rad),
        semi_major_m=true.semi_major_m * (1.0 + SIZE_SHARE * rng.normal(size=n)),
        semi_minor_m=true.semi_minor_m * (1.0 + SIZE_SHARE * rng.normal(size=n)),
        height_m=true.height_m + HEIGHT_M * rng.normal(size=n),
        errors=MapErrors(np.full(n, PLACE_M), np.full(n, SIZE_SHARE), np.full(n, HEIGHT_M)),
    )
    return replace(exact, catalog=stated)


def test_stated_errors_of_the_map_are_in_the_covariances(data: Dataset) -> None:
    """Unknown to the estimators, they gave an ANEES of a thousand."""
    run = reconstruct(data, ["smoother", "online", "ekf", "map_refining_smoother"])
    assert not any("outliers" in text for text in run.warnings)
    assert data.truth is not None
    for name, trajectory in run.trajectories.items():
        found = metrics(trajectory, data.truth)
        assert found.anees is not None, name
        assert found.anees < 15.0, name


def test_covariances_that_hold_the_errors_of_the_map_are_not_enlarged(data: Dataset) -> None:
    """Rims that say what their craters keep are left as they are; white errors that are large are split."""
    assert data.measurements is not None
    once = reconstruct(data, ["dead_reckoning"])
    assert not lack_map_errors(once.frames, data.catalog)
    whole = tuple(replace(one, rims=replace(one.rims, of_map=None)) for one in once.frames)
    assert lack_map_errors(whole, data.catalog)
    again = reconstruct(replace(data, measurements=whole), ["dead_reckoning"])
    for first, second, read in zip(once.frames, again.frames, data.measurements, strict=True):
        assert second.rims.of_map is not None
        np.testing.assert_array_equal(second.rims.covariance, first.rims.covariance)
        assert (np.linalg.eigvalsh(first.rims.covariance - read.rims.covariance) > -1e-12).all()


def test_errors_of_the_map_that_are_unknowns_count_once(data: Dataset) -> None:
    """Rims from images hold them: with the unknowns besides, standard deviations were 1.7 times too large."""
    name = "map_refining_smoother"
    first = reconstruct(data, ["ekf", name])
    held = reconstruct(replace(data, measurements=first.frames), [name])
    alone, other = first.trajectories[name], held.trajectories[name]
    assert alone.pose_covariance is not None
    assert other.pose_covariance is not None
    sigmas = [
        np.sqrt(np.trace(one[:, 3:, 3:], axis1=1, axis2=2))
        for one in (alone.pose_covariance, other.pose_covariance)
    ]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.05)
    apart = np.linalg.norm(other.gP - alone.gP, axis=1)
    assert (apart < 0.2 * sigmas[0]).all()


def test_arcs_hold_the_stated_errors_of_the_map(exact: Dataset, data: Dataset) -> None:
    """Two of five rims are arcs: without the errors of their craters the ANEES was in the thousands.

    As if they changed from image to image, the arcs made the smoother worse than none: 179 m and 21, not 133
    m and 4.9.
    """
    assert data.measurements is not None
    assert data.truth is not None
    rng, frames = np.random.default_rng(4), []
    for frame, gTb in zip(data.measurements, data.truth.gTb, strict=True):
        whole = frame.rims.craters < 3
        rows = frame.rims.craters[~whole]
        charts, _ = project_rims(gTb, data.camera.bTc, exact.catalog.centres[rows], exact.catalog.axes[rows])
        points, sigmas = [], []
        for chart in pixel_chart(charts, data.camera):
            angles = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 0.5 * np.pi, 15)
            on_rim, normal = points_and_normals(chart, angles)
            points.append(data.camera.normalised(on_rim + 0.3 * rng.normal(size=(15, 1)) * normal))
            sigmas.append(np.full(15, 0.3 / data.camera.focal_px))
        arcs = ArcSet(rows, tuple(points), tuple(sigmas))
        frames.append(replace(frame, rims=frame.rims.take(whole), arcs=arcs))
    seen = replace(data, measurements=tuple(frames))
    run = reconstruct(seen, ["smoother", "online", "ekf", "map_refining_smoother"])
    for name, trajectory in run.trajectories.items():
        found = metrics(trajectory, data.truth)
        assert found.anees is not None, name
        assert found.anees < 10.0, name
    # An arc that says what its points share is left as it is.
    first = run.frames[0].arcs
    assert first.correlated_sigmas is not None
    told = [replace(new.arcs, correlated_sigmas=2.0 * new.arcs.correlated_sigmas) for new in run.frames]
    saying = [replace(frame, arcs=arcs) for frame, arcs in zip(frames, told, strict=True)]
    again = reconstruct(replace(data, measurements=tuple(saying)), ["dead_reckoning"])
    np.testing.assert_array_equal(again.frames[0].arcs.correlated_sigmas, 2.0 * first.correlated_sigmas)


def test_rims_that_state_errors_of_their_own_get_those_of_the_map_as_well(data: Dataset) -> None:
    assert data.measurements is not None
    told = []
    for frame in data.measurements:
        root = np.sqrt(0.5) * np.linalg.cholesky(frame.rims.covariance)
        told.append(replace(frame, rims=replace(frame.rims, correlated=root)))
    assert lack_map_errors(told, data.catalog)
    run = reconstruct(replace(data, measurements=tuple(told)), ["ekf"])
    for frame, read in zip(run.frames, told, strict=True):
        A = frame.rims.of_map
        assert A is not None
        np.testing.assert_array_equal(frame.rims.correlated, read.rims.correlated)
        added = frame.rims.covariance - read.rims.covariance
        np.testing.assert_allclose(added, A @ np.swapaxes(A, 1, 2), atol=1e-12)
    # Slopes of planes alone are not the errors that the catalogue states.
    tilts = [replace(f, rims=replace(f.rims, of_map=np.zeros((len(f.rims), 5, 2)))) for f in told]
    assert lack_map_errors(tilts, data.catalog)
    assert not lack_map_errors(run.frames, data.catalog)


def test_without_a_filtered_pose_the_map_is_in_no_rim_twice(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of the map are white then; for what estimates them the rims are as they were read."""

    def fail(*_: object) -> None:
        raise EstimationError("no pose")

    monkeypatch.setattr(map_errors, "filtered_poses", fail)
    assert data.measurements is not None
    prepared = Measuring(data.initial, GuidedOptions(), (), {}, lambda *_: None).prepared(
        data, Relocaliser(data)
    )
    for frame, white, read in zip(
        prepared.without_map_errors(), prepared.measured.frames, data.measurements, strict=True
    ):
        assert white.rims.of_map is None
        assert (white.rims.covariance > read.rims.covariance)[:, [0, 1], [0, 1]].all()
        np.testing.assert_array_equal(frame.rims.covariance, read.rims.covariance)
