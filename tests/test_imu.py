"""Cuts of the IMU's log: every instant counts once, whatever the rows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.imu import ImuLog

RNG = np.random.default_rng(5)
STAMPS = 10**15 + np.cumsum(RNG.integers(5_000_000, 15_000_000, 40))
LOG = ImuLog(STAMPS, RNG.normal(size=(40, 3)), RNG.normal(size=(40, 3)))
FIRST = int(STAMPS[0] - (STAMPS[1] - STAMPS[0]))


def turned(until_ns: int) -> np.ndarray:
    """Integral (3,) of the angular velocity from the log's beginning, rad."""
    edges = np.append(FIRST, STAMPS)
    whole = np.vstack([np.zeros(3), np.cumsum(1e-9 * np.diff(edges)[:, None] * LOG.gyro_rad_s, axis=0)])
    return np.array([np.interp(until_ns - FIRST, edges - FIRST, column) for column in whole.T])


def test_the_parts_of_rows_add_up() -> None:
    inside = int(STAMPS[7]) + 1_000
    for begin, end in (
        (FIRST, int(STAMPS[-1])),
        (inside, inside + 2_000),
        (int(STAMPS[3]), int(STAMPS[4])),
        (int(STAMPS[3]) - 1, int(STAMPS[20]) + 1),
        (int(STAMPS[3]), int(STAMPS[3]) + 77),
        (FIRST + 5, int(STAMPS[0])),
    ):
        dt_s, gyro, force = LOG.between(begin, end)
        assert len(dt_s) == len(gyro) == len(force)
        assert (dt_s > 0.0).all()
        assert dt_s.sum() == pytest.approx(1e-9 * (end - begin), rel=1e-12)
        assert_allclose(dt_s @ gyro, turned(end) - turned(begin), atol=1e-12)
        # Both logs are cut alike.
        rows = [np.flatnonzero((LOG.gyro_rad_s == one).all(axis=1))[0] for one in gyro]
        assert_allclose(force, LOG.accelerometer_m_s2[rows])


@pytest.mark.parametrize("ends", [(-1, 10**7), (10**7, None), (10**7, 10**7), (2 * 10**7, 10**7)])
def test_what_the_log_does_not_cover_is_refused(ends: tuple[int, int | None]) -> None:
    begin = FIRST + ends[0]
    end = int(STAMPS[-1]) + 1 if ends[1] is None else FIRST + ends[1]
    with pytest.raises(ValueError, match=f"^IMU log covers {FIRST} to {STAMPS[-1]} ns, asked for {begin} to"):
        LOG.between(begin, end)


@pytest.mark.parametrize("length_ns", [1, 2, 3, 10**9, 10**9 + 1])
def test_a_lander_without_an_imu_turns_evenly(length_ns: int) -> None:
    begin = 10**15
    log = ImuLog.constant(begin, begin + length_ns, (0.1, -0.2, 0.3))
    assert begin < log.stamps_ns[0] < log.stamps_ns[1] <= begin + length_ns + 1
    dt_s, gyro, force = log.between(begin, begin + length_ns)
    assert dt_s.sum() == pytest.approx(1e-9 * length_ns)
    assert (gyro == [0.1, -0.2, 0.3]).all()
    assert not force.any()
