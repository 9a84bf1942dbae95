"""Heights along rims or of their planes: the rims themselves tell which, if they are large enough."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.catalogs.heights import chord_depths_m
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.measurements import RimSet
from craternav_fg.pipeline import rim_planes
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_tables import Crater, CraterList
from tests.descents import scenario

# Places (east, north) and semi-axes, km; direction of the major axis, deg.
LARGE_AND_SMALL = [
    (60.0, 50.0, 36.0, 30.0, 20.0),
    (-70.0, -40.0, 33.0, 29.0, 80.0),
    (-40.0, 60.0, 27.0, 24.0, 130.0),
    (8.0, -6.0, 4.0, 3.5, 40.0),
    (-7.0, -9.0, 3.5, 3.0, 0.0),
    (2.0, 9.0, 3.0, 2.8, 90.0),
]


@pytest.fixture(scope="module")
def high(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """From 300 km, where large craters are whole in view, to 40 km, where small ones are."""
    case = scenario(duration_s=120.0)
    placed = tuple(
        Crater(east_m=1e3 * e, north_m=1e3 * n, semi_major_m=1e3 * a, semi_minor_m=1e3 * b, angle_deg=angle)
        for e, n, a, b, angle in LARGE_AND_SMALL
    )
    path = case.trajectory
    path = path.model_copy(
        update={
            "start": path.start.model_copy(update={"altitude_m": 300e3}),
            "end": path.end.model_copy(update={"altitude_m": 40e3}),
        }
    )
    listed = CraterList(source="list", crater=placed)
    case = case.model_copy(update={"trajectory": path, "craters": listed})
    return Dataset.open(simulate(case, tmp_path_factory.mktemp("data") / "d"))


def error_m(data: Dataset, result: object) -> float:
    found = result.trajectories["ekf"].gTb[:, :3, 3]
    return float(np.linalg.norm(found - data.truth.gTb[:, :3, 3], axis=1).mean())


def test_mean_heights_along_rims_are_recognised_and_lowered(high: Dataset) -> None:
    catalog = high.catalog
    above_m = (catalog.semi_major_m**2 + catalog.semi_minor_m**2) / (4.0 * high.body.radius_m)
    assert above_m.min() < 5.0
    assert above_m.max() > 250.0
    of_points = replace(high, catalog=replace(catalog, height_m=catalog.height_m + above_m))
    planes, points = reconstruct(high, ["ekf"]), reconstruct(of_points, ["ekf"])
    assert not planes.lowered
    assert points.lowered
    assert any("mean height along the rims" in text for text in points.warnings)
    stated = points.problems[0]
    without = replace(stated, catalog=replace(stated.catalog, has_heights=False))
    unstated = replace(points, problems=(without,))
    (said,) = (text for text in unstated.warnings if "RIM_HEIGHT_M" in text)
    assert "the catalogue has no RIM_HEIGHT_M" in said
    assert error_m(high, points) == pytest.approx(error_m(high, planes), rel=0.05)


def test_a_filter_that_fails_does_not_decide(high: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = reconstruct(high, ["ekf"]).problems

    class Fails:
        def run(self, problem: Problem) -> None:
            raise EstimationError("no pose")

    # Of the points' heights the filter would be sure.
    catalog = frames[0].catalog
    raised = replace(catalog, height_m=catalog.height_m + chord_depths_m(catalog))
    of_points = [replace(problem, catalog=raised) for problem in frames]
    assert rim_planes.heights_of_points(of_points)
    for failing in (1, 2):
        filters = iter([*(failing - 1) * [rim_planes.ekf()], Fails(), rim_planes.ekf()])
        with monkeypatch.context() as patched:
            patched.setattr(rim_planes, "ekf", lambda left=filters: next(left))
            assert not rim_planes.heights_of_points(of_points)
    bare = [
        replace(one, frames=[replace(frame, rims=RimSet.empty()) for frame in one.frames]) for one in frames
    ]
    assert not rim_planes.heights_of_points(bare)


def test_rims_that_contradict_either_meaning_do_not_decide(high: Dataset) -> None:
    catalog = high.catalog
    wrong = {"semi_major_m": catalog.semi_major_m * 1.05, "semi_minor_m": catalog.semi_minor_m * 1.05}
    for sizes in (wrong, {"angle_rad": -catalog.angle_rad}):
        result = reconstruct(replace(high, catalog=replace(catalog, **sizes)), ["ekf"])
        assert not result.lowered


def test_small_rims_keep_their_heights(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=6.0), tmp_path / "d"))
    assert not reconstruct(data, ["ekf"]).lowered
