"""Hard cases: what is wrong is wrong by as much as asked, in the data set alone, and nothing else changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.simulation.faults import perturb_map, perturb_mounting, swap_matches
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario
from craternav_fg.simulation.scenario_tables import FaultsSection
from tests.descents import scenario

MOON = Body("Moon", 1_737_400.0, 4.9028e12, (0.0, 0.0, 2.66e-6))


def catalogue(n: int) -> Catalog:
    rng = np.random.default_rng(1)
    return Catalog(
        tuple(f"C{k}" for k in range(n)),
        rng.uniform(-1.2, 1.2, n), rng.uniform(-3.0, 3.0, n),
        np.full(n, 2000.0), np.full(n, 1900.0), rng.uniform(0.0, 3.0, n), np.zeros(n), MOON,
    )  # fmt: skip


@pytest.mark.parametrize("colatitude_rad", [None, 3e-5])
def test_a_perturbed_map_has_the_errors_asked_for(colatitude_rad: float | None) -> None:
    true = catalogue(4000)
    if colatitude_rad is not None:
        # So near a pole that shifts turn their longitudes round.
        off_pole = colatitude_rad * np.sqrt(np.linspace(1e-6, 1.0, 4000))
        true = replace(true, latitude_rad=off_pole - 0.5 * np.pi)
    faults = FaultsSection(map_place_share=0.02, map_size_share=0.01, map_height_share=0.05)
    told = perturb_map(true, faults, np.random.default_rng(2))
    gRe = frames.east_north_up(true.latitude_rad, true.longitude_rad)
    off = np.einsum("nji,nj->ni", gRe, told.centres - true.centres) / true.semi_major_m[:, None]
    assert_allclose(off.std(axis=0), [0.02, 0.02, 0.05], rtol=0.05)
    assert_allclose(np.abs(off.mean(axis=0)), 0.0, atol=4e-3)
    area = told.semi_major_m * told.semi_minor_m / (true.semi_major_m * true.semi_minor_m)
    assert_allclose(np.log(area).std(), np.sqrt(2.0) * 0.01, rtol=0.05)
    assert np.all(told.semi_major_m >= told.semi_minor_m)
    # Axes that changed places have turned: the longer one keeps within the scatter to where it was.
    assert told.identifiers == true.identifiers


def test_errors_of_size_alone_keep_the_directions_of_the_axes() -> None:
    true = catalogue(500)
    told = perturb_map(true, FaultsSection(map_size_share=0.1), np.random.default_rng(3))
    swapped = told.angle_rad != true.angle_rad
    assert 0.1 < swapped.mean() < 0.6
    # The direction of each true axis is still one of the axes.
    cosine = np.einsum("ni,ni->n", told.gRl[:, :, 0], true.gRl[:, :, 0])
    assert_allclose(np.where(swapped, 0.0, 1.0), np.abs(cosine), atol=1e-9)


def frame(n: int) -> FrameMeasurement:
    return FrameMeasurement(0, RimSet(np.arange(n), np.zeros((n, 5)), np.tile(np.eye(5), (n, 1, 1))), None)


@pytest.mark.parametrize("n", [1, 2, 3, 10])
def test_wrong_names_are_wrong_as_often_as_asked_and_never_there_twice(n: int) -> None:
    catalog, rng = catalogue(20), np.random.default_rng(4)
    wrong = []
    for _ in range(2000):
        craters = swap_matches(frame(n), catalog, FaultsSection(wrong_match_share=0.3), rng).rims.craters
        assert len(set(craters.tolist())) == n
        wrong.append(np.mean(craters != np.arange(n)))
    assert np.mean(wrong) == pytest.approx(0.3, abs=0.03)


def test_the_mounting_is_turned_by_the_angle_asked_for_and_not_moved() -> None:
    camera = scenario().camera.camera()
    told = perturb_mounting(camera, FaultsSection(mounting_deg=0.2), np.random.default_rng(5))
    angle = np.linalg.norm(frames.rotation_log(camera.bTc[:3, :3].T @ told.bTc[:3, :3]))
    assert np.degrees(angle) == pytest.approx(0.2, rel=1e-9)
    assert_array_equal(told.bTc[:3, 3], camera.bTc[:3, 3])


def made(folder: Path, **faults: object) -> Dataset:
    case = scenario(duration_s=8.0).model_dump()
    case["faults"].update(faults)
    return Dataset.open(simulate(Scenario.model_validate(case), folder))


def test_each_fault_changes_what_it_should_and_nothing_else(tmp_path: Path) -> None:
    plain = made(tmp_path / "plain")
    late = made(tmp_path / "late", time_offset_s=0.5)
    lost = made(tmp_path / "lost", outages_s=((2.0, 6.0),))
    dark = made(tmp_path / "dark", without_sun=True)
    assert plain.truth is not None
    assert late.truth is not None
    assert lost.truth is not None
    assert plain.measurements is not None
    assert late.measurements is not None
    assert dark.measurements is not None
    # The truth is that of the stamps; the rims are those of half a second, and some 75 m, later.
    assert_array_equal(late.truth.gTb, plain.truth.gTb)
    assert_array_equal(late.imu.gyro_rad_s, plain.imu.gyro_rad_s)
    shift = np.abs(late.measurements[0].rims.chart[0] - plain.measurements[0].rims.chart[0])
    assert np.max(shift) > 1e-3
    kept = np.isin(plain.stamps_ns, lost.stamps_ns)
    assert_array_equal(plain.stamps_ns[~kept] * 1e-9, [2.0, 4.0])
    assert_array_equal(lost.truth.gTb, plain.truth.gTb[kept])
    assert all(f.sun is None for f in dark.measurements)
    assert_array_equal(dark.measurements[0].rims.chart, plain.measurements[0].rims.chart)
