"""Logs in a wrong unit or order: the other sensors contradict them, and confirm them once corrected."""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.errors import EstimationError, InputError
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.instruments import IMU, RIMS
from craternav_fg.estimators.sensor_bank import SensorBank, linearise_sample
from craternav_fg.evaluation.innovations import innovations
from craternav_fg.linalg import whitening
from craternav_fg.pipeline import imu_mistakes
from craternav_fg.pipeline.imu_mistakes import ImuMistake
from craternav_fg.sensors.files import DATA, folder_of
from craternav_fg.sensors.protocol import STATE_SIZE, Sensor

# NIS per dimension, median of a log's samples: above the first it is refuted, below the second confirmed.
REFUTED, CONFIRMED = 100.0, 9.0
# Frames with rims on which the axes are tried; what they confirm is tried on all.
_FEW_FRAMES = 4


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
    """Refuse an IMU's log in another unit or along other axes, and a wrong spin, judged by what they predict.

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
    if problems[0].motion is not None or not _median_nis_of_imu(problems) > REFUTED:
        return
    few = [_beginning(problems[0])]
    screened = (one for one in imu_mistakes.axes(few[0].camera.bTc[:3, :3]) if _confirmed(one, few))
    # A spin makes up for a gyro's wrong unit or axes while a lander turns steadily: it comes last.
    for mistake in itertools.chain(imu_mistakes.units(), screened, imu_mistakes.spin(problems[0])):
        if _confirmed(mistake, problems):
            raise InputError(
                folder / mistake.file,
                f"{mistake.problem} (the other sensors confirm it)",
                column=mistake.column,
            )


def _beginning(problem: Problem) -> Problem:
    """Cut a problem after the first frames with rims from which a log can be judged."""
    first = problem.start.frame + 1
    with_rims = [k for k, frame in enumerate(problem.frames) if k >= first and len(frame.rims)]
    return replace(problem, frames=problem.frames[: (with_rims[:_FEW_FRAMES] or [first])[-1] + 1])


def _confirmed(mistake: ImuMistake, problems: Sequence[Problem]) -> bool:
    """Whether the log agrees with the other sensors once a mistake is undone."""
    return _median_nis_of_imu([mistake.undone(problem) for problem in problems]) < CONFIRMED


def _median_nis_of_imu(problems: Sequence[Problem]) -> float:
    """NIS per dimension of what IMUs predict, median over the frames; infinite where the rims are lost."""
    found: list[float] = []
    for problem in problems:
        try:
            run = ekf().run(problem)
            every = innovations(problem, run.states, run.predictions)
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
