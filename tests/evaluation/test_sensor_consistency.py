"""Distances from the prior, and mean squares that chance does not explain."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.evaluation.sensor_consistency import (
    improbable,
    prior_sigmas,
    smoothed_residuals,
    summarise,
)
from craternav_fg.trajectory import InitialState, Trajectory
from tests.descents import problem, scenario


def test_the_first_state_is_measured_in_sigmas_of_its_prior() -> None:
    R = frames.rotation_exp(np.array([0.3, -1.0, 0.4]))
    P, V = np.array([1e6, 2e6, -5e5]), np.array([30.0, -20.0, 5.0])
    initial = InitialState(0, frames.pose(R, P), V, 0.01, 50.0, 2.0, 0.0, 1e-4, 0.0)
    gTb = np.tile(frames.pose(R, P), (2, 1, 1))
    gTb[0] = frames.pose(
        R @ frames.rotation_exp(np.array([0.0, 0.0, -0.03])), P + np.array([0.0, 300.0, 400.0])
    )
    bias = np.array([[3e-4, 0.0, 4e-4, 9.0, 9.0, 9.0], np.zeros(6)])
    trajectory = Trajectory(np.array([0, 10**9]), gTb, np.array([V - np.array([0.0, 0.0, 8.0]), V]), bias)
    found = prior_sigmas(initial, trajectory)
    # Without a sigma, the accelerometer has no prior to be far from.
    expected = {"attitude": 3.0, "position": 10.0, "velocity": 4.0, "gyro bias": 5.0}
    assert found == pytest.approx(expected)


def test_residuals_that_are_not_finite_are_left_out() -> None:
    residuals = np.array([[1.0, -2.0], [np.nan, 100.0], [3.0, 4.0], [np.inf, 0.0]])
    found = summarise({"rims": residuals, "sun": np.array([[np.nan]])})
    assert list(found) == ["rims"]
    assert found["rims"].count == 2
    assert found["rims"].mean.tolist() == [2.0, 1.0]
    assert found["rims"].square == pytest.approx(30.0 / 4.0)


@pytest.mark.parametrize("dimension", [1, 40, 3000])
def test_chance_explains_all_but_one_mean_square_in_ten_million(dimension: int) -> None:
    assert not improbable(1.0, dimension)
    limits = chi2.isf([1e-7, 1.0 - 1e-7], dimension) / dimension
    for limit, beyond in zip(limits, (1.001, 0.999), strict=True):
        assert improbable(limit * beyond, dimension)
        assert not improbable(limit / beyond, dimension)


def test_residuals_at_the_truth_are_as_large_as_the_noise(tmp_path: Path) -> None:
    sensors = {"altimeter": {"rate_hz": 0.5, "bias_sigma_m": 1000.0}, "velocimeter": {"rate_hz": 0.5}}
    p, truth = problem(tmp_path, scenario(duration_s=60.0, sensors=sensors), 0)
    found = smoothed_residuals([p], truth)
    k = len(p.frames)
    shapes = {name: residuals.shape for name, residuals in found.items()}
    rims = sum(len(frame.rims) for frame in p.frames)
    assert shapes == {"rims": (rims, 5), "sun": (k, 1), "altimeter": (k, 1), "velocimeter": (k, 4)}
    for name, residuals in found.items():
        low, high = chi2.ppf([1e-5, 1.0 - 1e-5], residuals.size)
        assert low < np.sum(residuals**2) < high, name
    # A bias that its prior allows is no residual; samples of other stamps have none.
    biased = type(p.sensors[0])(
        p.sensors[0].settings, p.sensors[0].stamps_ns, p.sensors[0].values + 700.0, p.sensors[0].surroundings
    )
    again = smoothed_residuals([replace(p, sensors=(biased,))], truth.take(np.arange(5, 15)))
    assert set(again) == {"rims", "sun", "altimeter"}
    assert again["altimeter"].shape == (10, 1)
    assert_allclose(again["altimeter"].mean(), 0.0, atol=0.01)
    off = found["altimeter"][5:15] - found["altimeter"][5:15].mean()
    assert_allclose(again["altimeter"], off, atol=0.01)
