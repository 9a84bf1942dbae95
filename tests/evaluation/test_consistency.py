"""ANEES by altitude and NIS by sensor."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.evaluation.consistency import anees_by_altitude, mean_interval, over_altitude, rms
from craternav_fg.evaluation.innovations import IMU, RIMS, SUN, Innovations, innovations
from tests.estimators.small_descent import World, draw, make_world

TRIALS = 12


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(duration_s=40.0)


def pooled(problems: list[Problem]) -> Innovations:
    return Innovations.joined(innovations(p, ekf().states(p)) for p in problems)


def problems(world: World) -> list[Problem]:
    return [draw(world, np.random.default_rng(seed), start_scale=0.2) for seed in range(TRIALS)]


def test_nis_of_a_consistent_filter(world: World) -> None:
    found = pooled(problems(world))
    for sensor, most in ((RIMS, 5), (SUN, 1), (IMU, 6)):
        part = found.of(sensor)
        low, high = mean_interval(1, int(part.dimension.sum()), 0.9999)
        assert low < part.mean < high, sensor
        assert part.dimension.max() == most


def scaled(p: Problem, rims: float = 1.0, sun: float = 1.0) -> Problem:
    """Claim that rims or sun tilts are so much better than they are."""
    frames = [
        dataclasses.replace(
            f,
            rims=dataclasses.replace(f.rims, covariance=f.rims.covariance / rims**2),
            sun=None if f.sun is None else dataclasses.replace(f.sun, sigma_rad=f.sun.sigma_rad / sun),
        )
        for f in p.frames
    ]
    return dataclasses.replace(p, frames=frames)


def test_nis_names_the_sensor_that_claims_too_much(world: World) -> None:
    some = problems(world)[:4]
    unchanged = pooled(some)
    rims = pooled([scaled(p, rims=2.0) for p in some])
    sun = pooled([scaled(p, sun=2.0) for p in some])
    assert rims.of(RIMS).mean > 2.0
    assert sun.of(SUN).mean > 2.5
    assert sun.of(RIMS).mean == pytest.approx(unchanged.of(RIMS).mean, rel=0.05)
    # A gyro that turns by more than its prior allows: only predictions fail.
    better = [
        dataclasses.replace(p, imu=dataclasses.replace(p.imu, gyro_rad_s=p.imu.gyro_rad_s + np.radians(0.02)))
        for p in some
    ]
    imu = pooled(better)
    assert imu.of(IMU).mean > 1.5
    assert imu.of(IMU).mean > imu.of(RIMS).mean


def test_mean_interval_is_that_of_drawn_means() -> None:
    means = np.random.default_rng(1).chisquare(6, size=(20000, 30)).mean(axis=1)
    assert_allclose(mean_interval(6, 30), np.quantile(means, [0.025, 0.975]), rtol=5e-3)


def test_anees_is_of_the_frames_of_each_bin() -> None:
    altitude = np.array([100e3, 80e3, 60e3, 40e3, 20e3, 10e3])
    values = np.array([[6.0, 6.0, 9.0, 3.0, 1.0, 1.0], [6.0, 8.0, 9.0, 3.0, 1.0, 3.0]])
    bins = anees_by_altitude(values, altitude, [101e3, 80e3, 70e3, 40e3, 0.0])
    assert [one.mean for one in bins] == [6.5, 6.0, 1.5]
    assert [one.frames for one in bins] == [2, 2, 2]
    assert all(one.highest_m > one.lowest_m and one.low < 6.0 < one.high for one in bins)
    assert [one.consistent for one in bins] == [True, True, False]


def test_rms_is_over_trials_and_the_altitude_weighs_frames() -> None:
    assert_allclose(rms(np.array([[[3.0, 0.0, 0.0]], [[0.0, 4.0, 0.0]]])), [np.sqrt(12.5)])
    assert over_altitude(np.array([1.0, 1.0, 2.0]), np.array([100.0, 90.0, 80.0])) == pytest.approx(4.0 / 3.0)
    # Neither falls only nor rises only: over the frames.
    for altitude_km in ([10.0, 90.0, 10.0], [50.0, 50.0, 50.0]):
        assert over_altitude(np.array([1.0, 1.0, 4.0]), np.array(altitude_km)) == pytest.approx(2.0)
    assert over_altitude(np.array([3.0]), np.array([50.0])) == 3.0
    assert over_altitude(np.array([1.0, 1.0, 4.0]), np.array([100.0, 60.0, 55.0])) == pytest.approx(
        (40.0 + 22.5 + 4.0 * 5.0) / 67.5
    )


def test_innovations_of_sensors_and_of_segments() -> None:
    one = Innovations(
        (RIMS, "altimeter", RIMS, SUN), np.array([10, 10, 20, 20]), np.array([6.0, 2.0, 4.0, 0.0]),
        np.array([5, 1, 5, 0]),
    )  # fmt: skip
    other = Innovations(("altimeter", "beacon"), np.array([30, 40]), np.array([1.0, 8.0]), np.array([1, 2]))
    every = Innovations.joined([one, other])
    found = every.of("altimeter")
    assert found.sensor == ("altimeter", "altimeter")
    assert found.stamps_ns.tolist() == [10, 30]
    assert found.nis.tolist() == [2.0, 1.0]
    assert found.dimension.tolist() == [1, 1]
    figures = every.as_dict()
    assert list(figures) == [RIMS, SUN, "altimeter", "beacon"]
    assert figures[RIMS]["mean"] == pytest.approx(1.0)
    assert figures[RIMS]["dimension"] == 10
    # A chi-square of one degree of freedom is below 5.02 with a probability of 97.5 %, of two below 7.38.
    assert figures["altimeter"]["high"] == pytest.approx(7.378 / 2.0, rel=1e-3)
    assert figures["beacon"]["low"] == pytest.approx(0.0506 / 2.0, rel=1e-2)
    assert np.isnan(every.of(SUN).mean)
    assert every.of(SUN).interval[1] == pytest.approx(5.024, rel=1e-3)
    assert np.isnan(every.of("star").mean)
