"""Biases of sensors that estimators report beside the trajectory."""

from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.cli.run_summary import calibration_line
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.ekf.filter import DistributedEkf
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.runs.write import _calibrated
from tests.descents import problem, scenario

SENSORS = {
    "altimeter": {"rate_hz": 0.5, "bias_sigma_m": 50.0},
    "velocimeter": {"rate_hz": 0.5, "bias_sigma_m_s": 0.5},
}
SHIFTS = {"altimeter": 30.0, "velocimeter": 0.4}


@pytest.fixture(scope="module")
def descent(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    folder: Path = tmp_path_factory.mktemp("biases")
    return problem(folder, scenario(duration_s=40.0, sensors=SENSORS), 0)[0]


def shifted(p: Problem) -> Problem:
    """Let each sensor read more, by the same amount throughout."""
    sensors = []
    for sensor in p.sensors:
        other = copy(sensor)
        other.values = sensor.values + SHIFTS[sensor.name]
        sensors.append(other)
    return replace(p, sensors=tuple(sensors))


@pytest.mark.parametrize(
    "estimator", [BatchSmoother(), OnlineSmoother(), FixedLagSmoother(), DistributedEkf()]
)
def test_what_a_sensor_reads_too_much_is_found_in_its_bias(descent: Problem, estimator: Estimator) -> None:
    before, after = (estimator.estimate(p).calibrated for p in (descent, shifted(descent)))
    assert before is not None
    assert after is not None
    assert before.sensor_biases is not None
    assert after.sensor_biases is not None
    assert set(after.sensor_biases) == set(SHIFTS)
    for name, (bias, sigma) in after.sensor_biases.items():
        prior = next(sensor.bias_sigmas for sensor in descent.sensors if sensor.name == name)
        assert (sigma < 0.9 * prior).all()
        # The prior's mean is zero.
        expected = (1.0 - (sigma / prior) ** 2) * SHIFTS[name]
        np.testing.assert_allclose(bias - before.sensor_biases[name][0], expected, atol=0.1 * SHIFTS[name])


def test_biases_are_in_the_metrics_and_in_the_summary(descent: Problem) -> None:
    found = DistributedEkf().estimate(descent).calibrated
    assert found is not None
    written = _calibrated(found, descent)
    assert set(written["sensor_biases"]) == set(SHIFTS)
    assert len(written["sensor_biases"]["velocimeter"]["sigma"]) == len(descent.sensors[1].bias_sigmas)
    assert {name: one["unit"] for name, one in written["sensor_biases"].items()} == {
        "altimeter": "m",
        "velocimeter": "m s^-1",
    }
    told = {"bias": [0.3], "sigma": [0.01], "unit": "m"}
    assert calibration_line({"sensor_biases": {"altimeter": told}}) == "a bias of altimeter of 0.3 ± 0.01 m"
    line = calibration_line({"sensor_biases": {"doppler": {"bias": [0.3, -0.02], "sigma": [0.01, 0.01]}}})
    assert line == "a bias of doppler of 0.3 ± 0.01, -0.02 ± 0.01"


def test_nothing_is_reported_without_a_bias(descent: Problem) -> None:
    assert DistributedEkf().estimate(replace(descent, sensors=())).calibrated is None
    assert DeadReckoning().estimate(descent).calibrated is None
