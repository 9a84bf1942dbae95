"""A sensor and an estimator of another distribution, registered by entry points alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.runs.read import read_run
from tests.cli.calls import Done, call

ROOT = Path(__file__).resolve().parents[2]

# A sun sensor in some sixty lines: the direction towards the sun in b, measured by two angles.
SENSOR = '''
"""A sun sensor: the direction towards the sun in the sensor's axes."""

from typing import Literal

import numpy as np

from craternav_fg.sensors.protocol import ATTITUDE, STATE_SIZE, Linearisation, Sensor, SensorSettings
from craternav_fg.tables import Column

SUN = np.array([0.6, 0.0, 0.8])


class SunSensorSettings(SensorSettings):
    """`mav0/sun_sensor0/sensor.yaml`."""

    sensor_type: Literal["sun_sensor"] = "sun_sensor"
    sigma_rad: float = 1e-3


class SunSensor(Sensor):
    """Unit vectors towards the sun."""

    name = "sun_sensor"
    Settings = SunSensorSettings
    rows = 3

    @classmethod
    def columns(cls, settings):
        return tuple(Column(f"s_{axis}") for axis in "xyz")

    def linearise(self, row, state, bias):
        seen = state.gTb[:3, :3].T @ SUN
        J = np.zeros((3, STATE_SIZE))
        x, y, z = seen
        J[:, ATTITUDE] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / self.settings.sigma_rad
        return Linearisation((seen - self.values[row]) / self.settings.sigma_rad, J, np.zeros((3, 0)))

    def draw(self, state, bias, rng):
        return state.gTb[:3, :3].T @ SUN + self.settings.sigma_rad * rng.standard_normal(3)
'''

ESTIMATOR = '''
"""An estimator: dead reckoning under another name."""

from craternav_fg.estimators.dead_reckoning import DeadReckoning


class Carried:
    """The prior, carried on by the IMU."""

    name = "carried"

    def estimate(self, problem):
        return DeadReckoning().estimate(problem)
'''

SCENARIO = """
base = "measured_descent"
[trajectory]
duration_s = 24.0
site_latitude_deg = 0.67
site_longitude_deg = 23.47
heading_deg = 270.0
frame_interval_s = 4.0
[trajectory.start]
altitude_m = 12000.0
downrange_m = -3000.0
vertical_speed_m_s = -60.0
ground_speed_m_s = 150.0
vertical_acceleration_m_s2 = 0.0
ground_acceleration_m_s2 = -3.2
[trajectory.end]
altitude_m = 10500.0
downrange_m = 0.0
vertical_speed_m_s = -60.0
ground_speed_m_s = 100.0
vertical_acceleration_m_s2 = 0.0
ground_acceleration_m_s2 = -3.2
[trajectory.attitude]
start_pitch_deg = 20.0
end_pitch_deg = 20.0
oscillation_deg = [2.0, 1.5, 3.0]
oscillation_period_s = [60.0, 75.0, 110.0]
[sensors.sun_sensor]
rate_hz = 0.5
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages as pip makes it: two modules and the metadata of their distribution."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "other_sensor.py").write_text(SENSOR)
    (folder / "other_estimator.py").write_text(ESTIMATOR)
    about = folder / "other_lander-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: other-lander\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[craternav_fg.sensors]\nsun_sensor = other_sensor:SunSensor\n"
        "[craternav_fg.estimators]\ncarried = other_estimator:Carried\n"
    )
    (folder / "short.toml").write_text(SCENARIO)
    return folder


@pytest.fixture(scope="module")
def data(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "data"
    (done,) = in_turn(site, ["simulate", site / "short.toml", "-o", folder])
    assert done.code == 0, done.err
    assert (folder / "mav0/sun_sensor0/data.csv").is_file()
    return folder


def craternav(site: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    path = f"{ROOT}:{site}"
    return subprocess.run(
        [sys.executable, "-m", "craternav_fg", *map(str, arguments)],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


# Calls commands one after the other, and prints what they returned. Runs have no figures, as with `undrawn`.
IN_TURN = """
import json, sys
from unittest import mock
from tests.cli.calls import call

for words in json.loads(sys.argv[1]):
    with mock.patch("craternav_fg.runs.execute._figures", return_value={}):
        done = call(*words)
    print(json.dumps([done.code, done.out, done.err]))
"""


def in_turn(site: Path, *commands: list[str | Path]) -> list[Done]:
    """Run commands in one process that finds the packages: each of its own would import everything anew."""
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", IN_TURN, words],
        capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": f"{ROOT}:{site}"},
    )  # fmt: skip
    return [Done(*json.loads(line)) for line in done.stdout.splitlines()]


def test_the_command_line_lists_them(site: Path) -> None:
    sensors, estimators = (
        json.loads(done.out) for done in in_turn(site, ["sensors", "--json"], ["estimators", "--json"])
    )
    assert "Unit vectors towards the sun (mav0/sun_sensor0; other_sensor)" in sensors["sun_sensor"]
    assert "The prior, carried on by the IMU" in estimators["carried"]


def test_they_take_part_in_a_run_and_its_report(site: Path, data: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    names = ["smoother", "ekf", "carried"]
    done, without, *reports = in_turn(
        site,
        ["reconstruct", data, "-o", run, *(w for n in names for w in ("-e", n)), "--json"],
        ["reconstruct", data, "-o", tmp_path / "w", "-e", "smoother", "--without", "sun_sensor"],
        *(["report", folder] for folder in (run, tmp_path / "w")),
    )
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert list(found["estimators"]) == names
    nis = found["innovations"]["nis"]["sun_sensor"]
    assert nis["low"] < nis["mean"] < nis["high"]
    assert without.code == 0, without.err
    # A direction to 1 mrad tells of the attitude what rims and IMU do not.
    variances = []
    for folder in (run, tmp_path / "w"):
        covariance = read_run(folder).trajectories["smoother"].pose_covariance
        assert covariance is not None
        variances.append(np.trace(covariance[:, :3, :3], axis1=1, axis2=2))
    assert np.all(variances[0] < variances[1])
    pages = []
    for folder, report in zip((run, tmp_path / "w"), reports, strict=True):
        assert report.code == 0, report.err
        pages.append((folder / "report.html").read_text())
    # Only the run that they took part in tells of them.
    assert [("sun_sensor" in page, "carried" in page) for page in pages] == [(True, True), (False, False)]


@pytest.mark.usefixtures("undrawn")
def test_without_the_package_the_folder_is_told_of(data: Path, tmp_path: Path) -> None:
    done = call("reconstruct", data, "-o", tmp_path / "run", "-e", "smoother")
    assert done.code == 0
    assert "mav0/sun_sensor0" in done.err


def test_a_package_that_cannot_be_loaded_is_named(site: Path, tmp_path: Path) -> None:
    about = tmp_path / "broken-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[craternav_fg.sensors]\nlidar = not_there:Lidar\n")
    done = craternav(tmp_path, "sensors")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "lidar" in done.stderr
    assert "broken" in done.stderr
