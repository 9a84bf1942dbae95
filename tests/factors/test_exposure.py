"""Exposure factor: zero where it should be, its derivatives, its refusals."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, D, X, Y
from numpy.testing import assert_allclose

from factors.checking import numerical_jacobian
from factors.errors import FactorError
from factors.exposure import POSITION_SIGMA_M, ROTATION_SIGMA_RAD, exposure_factor

# A lander at 1 km/s that turns by 3 deg/s.
TWIST = np.array([0.03, -0.02, 0.04, 900.0, -300.0, 150.0])


def state(rng: np.random.Generator, off: float) -> gtsam.Values:
    """Any pose, a delay, a mounting error; the exposure's pose `off` its definition."""
    values = gtsam.Values()
    pose = gtsam.Pose3.Expmap(np.concatenate([rng.normal(size=3), 1e6 * rng.normal(size=3)]))
    mounting = gtsam.Pose3.Expmap(1e-2 * rng.normal(size=6))
    delay_s = float(rng.normal(scale=0.05))
    rate, speed = TWIST[:3], TWIST[3:]
    # Carried on by integration of the rigid motion in small steps, not by the exponential.
    steps = 20_000
    R, p = pose.rotation().matrix(), pose.translation()
    h = delay_s / steps
    turn = gtsam.Rot3.Expmap(h * rate).matrix()
    half = gtsam.Rot3.Expmap(0.5 * h * rate).matrix()
    for _ in range(steps):
        p = p + h * (R @ half @ speed)
        R = R @ turn
    exposed = gtsam.Pose3(gtsam.Rot3(R), p).compose(mounting)
    values.insert(X(0), pose)
    values.insert(Y(0), exposed.compose(gtsam.Pose3.Expmap(off * rng.normal(size=6))))
    values.insert(D(0), np.array([delay_s]))
    values.insert(C(0), mounting)
    return values


def test_zero_at_the_pose_that_rigid_motion_reaches() -> None:
    factor = exposure_factor(X(0), Y(0), TWIST, delay_key=D(0), mounting_key=C(0))
    for seed in range(3):
        e = factor.whitenedError(state(np.random.default_rng(seed), 0.0))
        assert_allclose(e[:3] * ROTATION_SIGMA_RAD, 0.0, atol=1e-12)
        assert_allclose(e[3:] * POSITION_SIGMA_M, 0.0, atol=1e-6)


@pytest.mark.parametrize("off", [0.0, 0.3])
@pytest.mark.parametrize(("delay", "mounting"), [(True, True), (True, False), (False, True)])
def test_derivatives_are_those_of_central_differences(off: float, delay: bool, mounting: bool) -> None:
    keys = {"delay_key": D(0) if delay else None, "mounting_key": C(0) if mounting else None}
    factor = exposure_factor(X(0), Y(0), TWIST, **keys)
    values = state(np.random.default_rng(7), off)
    J, _ = factor.linearize(values).jacobian()
    sizes = {
        X(0): [1e-4] * 3 + [1e-2] * 3,
        Y(0): [1e-4] * 3 + [1e-2] * 3,
        D(0): [1e-3],
        C(0): [1e-4] * 3 + [1e-2] * 3,
    }
    column = 0
    for key in factor.keys():  # noqa: SIM118 (a list)
        steps = sizes[key]
        numerical = numerical_jacobian(factor, values, key, steps)
        block = J[:, column : column + len(steps)]
        assert_allclose(block, numerical, rtol=1e-6, atol=1e-7 * np.abs(numerical).max())
        column += len(steps)
    assert column == J.shape[1]


def test_refusals_name_the_field() -> None:
    with pytest.raises(FactorError, match="twist"):
        exposure_factor(X(0), Y(0), [np.nan] * 6, delay_key=D(0))
    with pytest.raises(FactorError, match="delay_key"):
        exposure_factor(X(0), Y(0), TWIST)
