"""What users get wrong in an IMU's log and the camera's mounting beside it, and how to undo it."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg.dataset import layout
from craternav_fg.estimators.base import Problem
from factors.arrays import FloatArray

# Standard gravity, m/s^2, and columns of the IMU's log.
_G_M_S2 = 9.80665
_GYRO, _ACCELEROMETER, _MOUNTING = "w_RS_S_x", "a_RS_S_x", "T_BS"
_AXES = "xyz"


@dataclass(frozen=True)
class ImuMistake:
    """A mistake that an IMU's log or the camera's mounting may hold.

    Attributes
    ----------
    problem : str
        What was expected, and what was found.
    column : str
        Column or key at fault.
    file : Path
        File of the data set, relative to its folder.
    gyro, accelerometer : ndarray, shape (3, 3)
        Matrices from the axes and units of the log to those of b.
    has_gravity : bool
        False when the log's accelerations are those in space, without the reaction to gravity.
    """

    problem: str
    column: str
    gyro: FloatArray
    accelerometer: FloatArray
    file: Path = Path(layout.IMU_DATA)
    has_gravity: bool = True

    def undone(self, problem: Problem) -> Problem:
        """Return a problem as it is without the mistake.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Problem
        """
        log = problem.imu
        imu = replace(
            log,
            gyro_rad_s=log.gyro_rad_s @ self.gyro.T,
            accelerometer_m_s2=log.accelerometer_m_s2 @ self.accelerometer.T,
        )
        # What acts on such a log is no field; a body of no mass has none.
        mu = problem.body.mu_m3_s2 if self.has_gravity else np.finfo(np.float64).tiny
        return replace(problem, imu=imu, body=replace(problem.body, mu_m3_s2=float(mu)))


def units() -> Iterator[ImuMistake]:
    """Yield logs in deg/s, in g, or without the reaction to gravity.

    Yields
    ------
    ImuMistake
    """
    same = np.eye(3)
    yield ImuMistake("expected rad/s, found deg/s", _GYRO, np.radians(same), same)
    yield ImuMistake("expected m/s^2, found g", _ACCELEROMETER, same, _G_M_S2 * same)
    both = "expected rad/s and m/s^2, found deg/s and g"
    yield ImuMistake(both, _GYRO, np.radians(same), _G_M_S2 * same)
    found = "expected specific force, found acceleration, from which gravity was removed"
    yield ImuMistake(found, _ACCELEROMETER, same, same, has_gravity=False)


def axes(bRc: FloatArray) -> Iterator[ImuMistake]:
    """Yield logs along other axes, and mountings of the camera that are turned or inverse.

    Parameters
    ----------
    bRc : ndarray, shape (3, 3)
        Attitude of the camera in b, as stated.

    Yields
    ------
    ImuMistake
    """
    same = np.eye(3)
    about_axis = {90 * turns: _about_optical_axis(bRc, turns) for turns in (1, 2, 3)}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            M = np.diag(signs)[:, np.argsort(order)]
            if (same == M).all():
                continue
            names = [f"{'-' if sign < 0.0 else ''}{_AXES[k]}" for sign, k in zip(signs, order, strict=True)]
            found = f"expected the axes x, y, z of b, found them as {', '.join(names)} of"
            other = "or the camera's T_BS turned as much"
            for turn_deg, turn in about_axis.items():
                if np.allclose(M, turn):
                    other = f"or the camera or its images turned by {turn_deg} deg about the optical axis"
            yield ImuMistake(f"{found} the log, {other}", _GYRO, M, M)
            # Seldom are axes both interchanged and reversed in one of the two sensors alone.
            if order == (0, 1, 2) or min(signs) > 0.0:
                yield ImuMistake(f"{found} the gyro", _GYRO, M, same)
                yield ImuMistake(f"{found} the accelerometer", _ACCELEROMETER, same, M)
    yield ImuMistake("expected the axes of b, found those of the camera", _GYRO, bRc, bRc)
    # A camera that is mounted otherwise than stated turns b against the IMU.
    M = bRc @ bRc
    yield ImuMistake("expected bTc, found its inverse", _MOUNTING, M, M, Path(layout.CAMERA_SENSOR))
    for turn_deg, M in about_axis.items():
        found = (
            f"the camera or its images are turned by {turn_deg} deg about the optical axis against the IMU"
        )
        yield ImuMistake(found, _MOUNTING, M, M, Path(layout.CAMERA_SENSOR))


def _about_optical_axis(bRc: FloatArray, turns: int) -> FloatArray:
    """Rotation (3, 3) in b by some quarter turns about the camera's optical axis."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(bRc @ np.linalg.matrix_power(quarter, turns) @ bRc.T)
