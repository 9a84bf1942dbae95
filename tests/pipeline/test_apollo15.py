"""Apollo 15's photographs from the files to the arc, by the commands and the options of the documentation."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.catalogs.dem import read_dem
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.dem_check import check_against_dem
from craternav_fg.evaluation.offsets import leave_one_out, offsets
from craternav_fg.pipeline.options_file import OptionsFile
from craternav_fg.pipeline.reconstruct import reconstruct
from tests.cli.calls import call
from tests.shared_data import shared

pytest.importorskip("pvl")
pytest.importorskip("rasterio")
pytestmark = pytest.mark.slow

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "apollo15.md").read_text(encoding="utf-8")


def block(kind: str, beginning: str) -> str:
    """The block of the page that begins so."""
    return next(
        text for text in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.S) if text.startswith(beginning)
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("apollo15")
    catalogs = [str(shared(f"{name}.csv")) for name in ("robbins_2018_subset", "moon_head_povilaitis_5km")]
    craters, dem = str(folder / "craters.parquet"), str(shared("gld100/gld100_16ppd_global.tif"))
    call("catalog", "merge", *catalogs, "-o", craters, "--dem", dem)
    times = folder / "times.csv"
    times.write_text(block("text", "filename,utc"))
    cubes = [str(shared(f"apollo15/AS15-M-0{k}_crop.cub")) for k in range(297, 301)]
    images = [str(shared(f"apollo15/AS15-M-0{k}_SML.png")) for k in range(295, 301)]
    given = [text for image in images for text in ("--photographs", image)]
    where = str(folder / "data")
    call("import", "isis", *cubes, *given, "--times", str(times), "--catalog", craters, "-o", where)
    (folder / "apollo15.toml").write_text(block("toml", "[front_end]"))
    return Dataset.open(where)


@pytest.fixture(scope="module")
def arc(data):
    options = OptionsFile(data.path.parent / "apollo15.toml")
    smoother = options.estimator("smoother")
    return reconstruct(data, [smoother], front_end=options.front_end), smoother


def test_the_arc_is_as_good_as_stated(data, arc):
    result, _ = arc
    # No initial state is given: two frames are identified, the others follow.
    assert data.initial is None
    assert result.origin == "found"
    assert not result.reinitialised_at
    assert min(len(frame.rims) for frame in result.frames) >= 12
    found = offsets(result.trajectories["smoother"], data.apriori.states)
    assert np.all(found.scatter_m <= 60.0)
    assert abs(found.enu_m[:, 2].mean() + 1100.0) <= 200.0
    # The page states this run, to half a standard deviation.
    row = PAGE.partition("| scatter about the mean |")[2]
    stated = [int(text) for text in re.findall(r"(\d+) m", row)[:3]]
    assert np.all(np.abs(found.scatter_m - stated) <= 30.0)
    # The scatter is within what the arc claims at its ends, where a drift shows.
    assert np.all(found.scatter_m < found.sigma_m.max(axis=0))


def test_craters_may_stand_in_any_order(data, arc):
    """A file keeps them by place, a catalogue merged in memory by source."""
    result, smoother = arc
    order = np.random.default_rng(1).permutation(len(data.catalog))
    mixed = replace(data, catalog=data.catalog.take(order))
    options = OptionsFile(data.path.parent / "apollo15.toml")
    again = reconstruct(mixed, [smoother], front_end=options.front_end)
    assert [len(frame.rims) for frame in again.frames] == [len(frame.rims) for frame in result.frames]
    one, other = (run.trajectories["smoother"].gTb for run in (result, again))
    np.testing.assert_allclose(other[:, :3, 3], one[:, :3, 3], atol=1.0)


def test_each_frame_is_predicted_by_the_others(arc):
    result, smoother = arc
    found = leave_one_out(result.problems, smoother, result.trajectories["smoother"].stamps_ns)
    assert found.frames.tolist() == list(range(6))
    assert np.all(np.abs(found.enu_m) <= 3.0 * found.sigma_m)


def test_an_elevation_model_agrees_with_the_altitude(data, arc):
    dem = read_dem(shared("gld100/gld100_64ppd_apollo15_metric.tif"))
    trajectory = arc[0].trajectories["smoother"]
    found = [
        check_against_dem(
            data.image(k), data.camera, trajectory.gTb[k], data.sun.at(int(data.stamps_ns[k])), dem,
            data.body.radius_m,
        )
        for k in (0, 3, 5)
    ]  # fmt: skip
    assert abs(np.mean([one.altitude_m for one in found])) <= 100.0
    # A single frame is correlated to some 40 m.
    assert max(abs(one.altitude_m) for one in found) <= 150.0
    assert min(one.correlation for one in found) > 0.88
    assert max(float(np.hypot(*one.shift_px)) for one in found) < 1.5
