"""Odd but allowed: names of any letters, ground without craters, folders that cannot be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.simulation.scenario_file import Scenario
from craternav_fg.simulation.scenario_tables import Crater, CraterList
from tests import descents
from tests.campaign.scene import write_scenario
from tests.cli.calls import call

# An emoji, rich's markup, HTML, a line break.
NAME = "\U0001f311[/b]<i>é\n%s"


def without_rims() -> Scenario:
    """Give a descent whose only crater is on the other side of the body."""
    away = Crater(east_m=2.5e6, north_m=0.0, semi_major_m=2e3, semi_minor_m=1.5e3, angle_deg=0.0)
    return descents.scenario(duration_s=6.0).model_copy(
        update={"craters": CraterList(source="list", crater=(away,))}
    )


def with_an_odd_body() -> Scenario:
    case = descents.scenario(duration_s=6.0)
    return case.model_copy(update={"body": case.body.model_copy(update={"name": NAME})})


@pytest.mark.parametrize("case", [without_rims, with_an_odd_body])
def test_what_is_written_is_read_again(case: object, tmp_path: Path) -> None:
    """From scenario to report, in folders of an odd name."""
    folder = tmp_path / NAME.replace("/", "|")
    folder.mkdir()
    assert callable(case)
    scenario = write_scenario(folder / "scenario.toml", case())
    data, run = folder / "data", folder / "run"
    for command in (
        ("simulate", scenario, "-o", data),
        ("reconstruct", data, "-o", run, "-e", "smoother,ekf,dead_reckoning"),
        ("report", run),
        ("compare", run),
        ("catalog", "info", data / "craters.csv"),
    ):
        done = call(*command)
        assert done.code == 0, f"{command}: {done.err}"
    assert (run / "report.html").is_file()
    measured = Dataset.open(data).measurements
    assert measured is not None
    if case is without_rims:
        assert not any(len(frame.rims) for frame in measured)


@pytest.mark.slow
def test_the_home_need_not_be_writable(tmp_path: Path) -> None:
    nowhere = {"HOME": "/proc", "XDG_CACHE_HOME": "/proc/cache", "XDG_CONFIG_HOME": "/proc/config"}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **nowhere}
    scenario = write_scenario(tmp_path / "scenario.toml", descents.scenario(duration_s=6.0))
    for command in (
        ["--help"],
        ["simulate", str(scenario), "-o", str(tmp_path / "data")],
        ["reconstruct", str(tmp_path / "data"), "-o", str(tmp_path / "run"), "-e", "dead_reckoning"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "craternav_fg", *command],
            capture_output=True, text=True, env=environment, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
