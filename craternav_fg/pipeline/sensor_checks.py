"""Logs in a wrong unit or order: the other sensors contradict them, and confirm them once corrected."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.dataset import layout
from craternav_fg.errors import EstimationError, InputError
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.instruments import IMU, RIMS
from craternav_fg.estimators.sensor_bank import SensorBank, linearise_sample
from craternav_fg.evaluation.innovations import innovations
from craternav_fg.imu import ImuLog
from craternav_fg.linalg import whitening
from craternav_fg.sensors.files import DATA, folder_of
from craternav_fg.sensors.protocol import STATE_SIZE, Sensor

# Standard gravity, m/s^2, and columns of the IMU's log.
_G_M_S2 = 9.80665
_GYRO, _ACCELEROMETER = "w_RS_S_x", "a_RS_S_x"
# NIS per dimension, median of a log's samples: above the first it is refuted, below the second confirmed.
REFUTED, CONFIRMED = 100.0, 9.0


def check_logs(problems: Sequence[Problem], folder: Path) -> None:
    """Refuse a sensor's log in a wrong unit or order.

    The filter predicts each sample from all other data; it drops those that contradict the prediction, so
    that a wrong log does not spoil it.

    Parameters
    ----------
    problems : sequence of Problem
    folder : Path
        Folder of the data set, for messages.

    Raises
    ------
    InputError
        Naming file and column, what was expected and what was found.
    """
    sensors = [sensor for sensor in problems[0].sensors if sensor.misreadings()]
    if not sensors:
        return
    states = [state for problem in problems for state in _states(problem)]
    for sensor in sensors:
        if not _median_nis(sensor, states) > REFUTED:
            continue
        for text, values in sensor.misreadings().items():
            other = type(sensor)(sensor.settings, sensor.stamps_ns, values, sensor.surroundings)
            if _median_nis(other, states) < CONFIRMED:
                column, problem = text.split(": ", 1)
                raise InputError(
                    folder / folder_of(sensor.name) / DATA,
                    f"{problem} (the other sensors confirm it)",
                    column=column,
                )


def check_imu(problems: Sequence[Problem], folder: Path) -> None:
    """Refuse an IMU's log in deg/s or in g, judged by what it predicts.

    Parameters
    ----------
    problems : sequence of Problem
    folder : Path
        Folder of the data set, for messages.

    Raises
    ------
    InputError
        Naming file and column, what was expected and what was found.
    """
    imu = problems[0].imu
    if problems[0].motion is not None or not _median_nis_of_imu(problems, imu) > REFUTED:
        return
    in_rad = replace(imu, gyro_rad_s=np.radians(imu.gyro_rad_s))
    in_m = replace(imu, accelerometer_m_s2=_G_M_S2 * imu.accelerometer_m_s2)
    for other, column, problem in (
        (in_rad, _GYRO, "expected rad/s, found deg/s"),
        (in_m, _ACCELEROMETER, "expected m/s^2, found g"),
        (
            replace(in_rad, accelerometer_m_s2=in_m.accelerometer_m_s2),
            _GYRO,
            "expected rad/s and m/s^2, found deg/s and g",
        ),
    ):
        if _median_nis_of_imu(problems, other) < CONFIRMED:
            raise InputError(
                folder / layout.IMU_DATA, f"{problem} (the other sensors confirm it)", column=column
            )


def _median_nis_of_imu(problems: Sequence[Problem], imu: ImuLog) -> float:
    """NIS per dimension of what a log predicts, median over the frames; infinite where the rims are lost."""
    found: list[float] = []
    for problem in problems:
        assumed = replace(problem, imu=imu)
        try:
            run = ekf().run(assumed)
            every = innovations(assumed, run.states, run.predictions)
        except (EstimationError, *NUMERICAL_ERRORS):
            return float("inf")
        in_sight = Counter(every.of(RIMS).stamps_ns.tolist())
        of_imu = every.of(IMU)
        each = zip(of_imu.nis, of_imu.dimension, strict=True)
        judged = dict(zip(of_imu.stamps_ns.tolist(), each, strict=True))
        for frame in problem.frames[problem.start.frame + 1 :]:
            nis, size = judged.get(frame.stamp_ns, (0.0, 0))
            # Rims that are out of sight have no innovation; the sun's tilt alone would confirm any log.
            if 2 * in_sight[frame.stamp_ns] < len(frame.rims) + len(frame.arcs):
                found.append(float("inf"))
            elif size:
                found.append(float(nis) / int(size))
    return float(np.median(found)) if found else float("nan")


def _states(problem: Problem) -> Iterator[tuple[int, FilterState]]:
    """Stamps and states of the filter from the start's frame on."""
    first = problem.start.frame
    states = ekf().states(problem)
    yield from zip([frame.stamp_ns for frame in problem.frames[first:]], states[first:], strict=True)


def _median_nis(sensor: Sensor, states: Sequence[tuple[int, FilterState]]) -> float:
    """NIS per dimension of a log alone, its bias at its prior: the median over its samples."""
    bank = SensorBank([sensor])
    size = STATE_SIZE + len(bank.sigmas)
    found = []
    for stamp_ns, state in states:
        for sample in bank.at(stamp_ns):
            P = np.zeros((size, size))
            P[:STATE_SIZE, :STATE_SIZE] = state.covariance[:STATE_SIZE, :STATE_SIZE]
            P[STATE_SIZE:, STATE_SIZE:] = np.diag(bank.sigmas**2)
            alone = FilterState(state.gTb, state.gV, state.rate, state.bias, P, np.zeros(len(bank.sigmas)))
            A, residual = linearise_sample(sample, alone, np.zeros(size), stamp_ns)
            if not A.any():
                continue
            innovation = whitening(A @ P @ A.T + np.eye(len(A))) @ residual
            found.append(float(innovation @ innovation) / len(innovation))
    return float(np.median(found)) if found else float("nan")
