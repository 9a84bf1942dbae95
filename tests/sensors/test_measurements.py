"""Sensors' measurement functions: derivatives, whiteness at the truth, and what is refused."""

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, S, V, X
from pydantic import ValidationError

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.sensors.altimeter import Altimeter, AltimeterSettings
from craternav_fg.sensors.protocol import STATE_SIZE, Mounting, Sensor, SensorState, Surroundings
from craternav_fg.sensors.ranging import Ranging, RangingSettings
from craternav_fg.sensors.star_tracker import StarTracker, StarTrackerSettings
from craternav_fg.sensors.velocimeter import Velocimeter, VelocimeterSettings
from factors.custom import Loss
from factors.kernels import robust
from factors.state_measurement import state_measurement_factor

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 1e-6, 2.661_7e-6))
FLAT = Surroundings(MOON, lambda _: 0.0)

# Steps of the attitude: ranges are rounded to 1e-9 m, and smaller turns of a short lever arm would show it.
TURN_RAD = {"altimeter": 1e-4, "star_tracker": 1e-4, "velocimeter": 1e-4, "ranging": 1e-3}


def mounting(rng: np.random.Generator) -> Mounting:
    bTs = frames.pose(frames.rotation_exp(0.05 * rng.standard_normal(3)), rng.uniform(-2.0, 2.0, 3))
    return Mounting(data=tuple(bTs.ravel().tolist()))


def draw_state(rng: np.random.Generator, altitude_m: float) -> SensorState:
    """A lander that looks down, up to 20 deg off, anywhere."""
    site = frames.east_north_up(rng.uniform(-1.0, 1.0, 1), rng.uniform(0.0, 6.0, 1))[0]
    down = site @ np.diag([1.0, -1.0, -1.0])
    gRb = down @ frames.rotation_exp(rng.uniform(-0.2, 0.2, 3))
    return SensorState(
        int(rng.integers(10**12)),
        frames.pose(gRb, (MOON.radius_m + altitude_m) * site[:, 2]),
        rng.normal(scale=300.0, size=3),
        rng.normal(scale=0.02, size=3),
    )


def moved(state: SensorState, step: np.ndarray) -> SensorState:
    gTb = frames.pose(state.gTb[:3, :3] @ frames.rotation_exp(step[:3]), state.gTb[:3, 3] + step[3:6])
    return SensorState(state.stamp_ns, gTb, state.gV + step[6:9], state.rate_rad_s + step[9:12])


CASES: dict[str, tuple[type[Sensor], Callable[[Mounting], object]]] = {
    "altimeter": (
        Altimeter,
        lambda m: AltimeterSettings(T_BS=m, noise_m=0.3, noise_share=1e-4, bias_sigma_m=5.0),
    ),
    "star_tracker": (StarTracker, lambda m: StarTrackerSettings(T_BS=m, epoch_ns=5, roll_sigma_arcsec=80.0)),
    "velocimeter": (Velocimeter, lambda m: VelocimeterSettings(T_BS=m, noise_share=1e-3, bias_sigma_m_s=0.1)),
    "ranging": (Ranging, lambda m: RangingSettings(T_BS=m, bias_sigma_m=10.0)),
}


def one(name: str, seed: int) -> tuple[Sensor, SensorState, np.ndarray, np.random.Generator]:
    """A sensor with a single sample, the state it was drawn at, and its bias."""
    rng = np.random.default_rng(seed)
    kind, settings = CASES[name]
    state = draw_state(rng, 10.0 ** rng.uniform(1.5, 5.0))
    sensor = kind(settings(mounting(rng)), np.array([state.stamp_ns]), np.zeros((1, 0)), FLAT)
    bias = sensor.bias_sigmas * rng.standard_normal(len(sensor.bias_sigmas))
    sensor.values = sensor.draw(state, bias, rng)[None]
    return sensor, state, bias, rng


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_central_differences(name: str, seed: int) -> None:
    sensor, state, bias, rng = one(name, seed)
    # Away from the truth, where errors are not small.
    state = moved(state, np.repeat([0.02, 3.0, 1.0, 0.01, 0.0, 0.0], 3) * rng.standard_normal(STATE_SIZE))
    found = sensor.linearise(0, state, bias)
    steps = np.repeat([TURN_RAD[name], 1.0, 1e-3, 1e-5], 3)
    for j, size in enumerate(steps):
        step = np.zeros(STATE_SIZE)
        step[j] = size
        ahead, back = (sensor.linearise(0, moved(state, sign * step), bias).error for sign in (1.0, -1.0))
        slope = (ahead - back) / (2.0 * size)
        scale = np.abs(found.jacobian[:, j - j % 3 : j - j % 3 + 3]).max() + 1e-12
        np.testing.assert_allclose(found.jacobian[:, j], slope, atol=1e-6 * scale + 1e-9)
    assert not found.jacobian[:, 12:].any()
    for j in range(len(bias)):
        step = np.zeros(len(bias))
        step[j] = 1e-3
        slope = (
            sensor.linearise(0, state, bias + step).error - sensor.linearise(0, state, bias - step).error
        ) / 2e-3
        np.testing.assert_allclose(found.bias_jacobian[:, j], slope, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_residuals_at_the_truth_are_white(name: str) -> None:
    errors = []
    for seed in range(400):
        sensor, state, bias, _ = one(name, 1000 + seed)
        errors.append(sensor.linearise(0, state, bias).error)
    every = np.array(errors)
    count, size = every.shape
    # Mean of chi-square over its freedom, and of each component: 4 standard errors.
    assert abs(np.mean(every**2) - 1.0) < 4.0 * np.sqrt(2.0 / (count * size))
    assert np.abs(every.mean(axis=0)).max() < 4.0 / np.sqrt(count)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CASES)
def test_the_factor_has_the_measurements_derivatives(name: str, seed: int) -> None:
    sensor, state, bias, rng = one(name, 50 + seed)
    gyro_bias = rng.normal(scale=1e-4, size=3)
    rows = len(sensor.linearise(0, state, bias).error)

    def measure(gTb, gV, rate, b):
        found = sensor.linearise(0, SensorState(state.stamp_ns, gTb, gV, rate), b)
        return found.error, found.jacobian, found.bias_jacobian

    loss = Loss(robust.HUBER, 0.5)
    bias_key = S(3) if len(bias) else None
    factor = state_measurement_factor(
        (X(0), V(0), B(0)), state.rate_rad_s + gyro_bias, rows, measure, bias_key, loss
    )
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(state.gTb))
    values.insert(V(0), state.gV)
    values.insert(B(0), gtsam.imuBias.ConstantBias(np.zeros(3), gyro_bias))
    if len(bias):
        values.insert(S(3), bias)
    linear = factor.linearize(values)
    J, b = linear.jacobian()
    # The loss is Huber's of the whole residual: half its sum of squares is the error.
    e = sensor.linearise(0, state, bias).error
    norm = float(np.linalg.norm(e))
    assert factor.error(values) == pytest.approx(
        0.5 * norm**2 if norm < 0.5 else 0.5 * (norm - 0.25), rel=1e-9
    )
    weight = 1.0 if norm < 0.5 else np.sqrt(0.5 / norm)
    np.testing.assert_allclose(b, -weight * e, rtol=1e-9, atol=1e-12)
    sizes = np.concatenate([np.repeat([TURN_RAD[name], 1.0, 1e-3, 1.0, 1e-5], 3), np.full(len(bias), 1e-3)])
    for j, size in enumerate(sizes):
        delta = gtsam.VectorValues()
        step = np.zeros(len(sizes))
        step[j] = size
        ends = []
        for sign in (1.0, -1.0):
            delta = gtsam.VectorValues()
            for key, part in ((X(0), slice(0, 6)), (V(0), slice(6, 9)), (B(0), slice(9, 15))):
                delta.insert(key, sign * step[part])
            if len(bias):
                delta.insert(S(3), sign * step[15:])
            there = values.retract(delta)
            state_there = SensorState(
                state.stamp_ns,
                there.atPose3(X(0)).matrix(),
                there.atVector(V(0)),
                state.rate_rad_s + gyro_bias - there.atConstantBias(B(0)).gyroscope(),
            )
            ends.append(sensor.linearise(0, state_there, there.atVector(S(3)) if len(bias) else bias).error)
        slope = weight * (ends[0] - ends[1]) / (2.0 * size)
        scale = np.abs(J[:, j - j % 3 : j - j % 3 + 3]).max() + 1e-9
        np.testing.assert_allclose(J[:, j], slope, atol=5e-6 * scale)


@pytest.mark.parametrize(
    ("settings", "values"),
    [
        (AltimeterSettings, {"boresight": (0.0, 0.0, 0.0)}),
        (VelocimeterSettings, {"beams": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))}),
        (StarTrackerSettings, {"inertial_attitude_wxyz": (0.0, 0.0, 0.0, 0.0)}),
    ],
)
def test_directions_and_quaternions_of_length_zero_are_refused(settings, values) -> None:
    """An altimeter without a boresight would measure nothing, in silence."""
    with pytest.raises(ValidationError, match="expected numbers of which one is not zero"):
        settings(T_BS=mounting(np.random.default_rng(1)), **values)
