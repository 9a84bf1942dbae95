"""Distances from the prior, and mean squares that chance does not explain."""

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.evaluation.sensor_consistency import improbable, prior_sigmas, summarise
from craternav_fg.trajectory import InitialState, Trajectory


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
