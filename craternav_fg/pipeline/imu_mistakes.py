"""What users get wrong in an IMU's log, the camera's mounting and the body's spin, and how to undo it."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg import frames
from craternav_fg.dataset import layout
from craternav_fg.estimators.base import Problem
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray

# Standard gravity, m/s^2, and columns of the IMU's log.
_G_M_S2 = 9.80665
_GYRO, _ACCELEROMETER, _MOUNTING = "w_RS_S_x", "a_RS_S_x", "T_BS"
_AXES = "xyz"
# Rims that determine a pose and check it, and images from whose poses the body's spin is found.
_POSE_RIMS, _POSES = 3, 24


@dataclass(frozen=True)
class ImuMistake:
    """A mistake that makes an IMU's log contradict the images.

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
    spin_rad_s : tuple of float or None
        Angular velocity of the body in g, where that was stated wrongly.
    """

    problem: str
    column: str
    gyro: FloatArray
    accelerometer: FloatArray
    file: Path = Path(layout.IMU_DATA)
    has_gravity: bool = True
    spin_rad_s: tuple[float, float, float] | None = None

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
        spin_rad_s = self.spin_rad_s or problem.body.spin_rad_s
        return replace(
            problem, imu=imu, body=replace(problem.body, mu_m3_s2=float(mu), spin_rad_s=spin_rad_s)
        )


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


def spin(problem: Problem) -> Iterator[ImuMistake]:
    """Yield the spin that gyro and rims show: the lander turns in space by one and against g by the other.

    Parameters
    ----------
    problem : Problem

    Yields
    ------
    ImuMistake
        None when fewer than two frames have a pose of their own.
    """
    of_rims = _attitudes(problem)
    if len(of_rims) < 2:
        return
    first_ns = of_rims[0][0]
    turns, times_s, G = [], [], np.eye(3)
    for (begin_ns, _), (end_ns, gRb) in itertools.pairwise(of_rims):
        dt_s, gyro, _ = problem.imu.between(begin_ns, end_ns)
        for turn in frames.rotation_exp(gyro * dt_s[:, None]):
            G = G @ turn
        # By the spin the other way.
        turns.append(gRb @ (of_rims[0][1] @ G).T)
        times_s.append(1e-9 * (end_ns - first_ns))
    rate = np.zeros(3)
    # The first turn is unambiguous, and each gives the spin well enough for the next.
    for turn, time_s in zip(turns, times_s, strict=True):
        rate = rate - frames.rotation_log(frames.rotation_exp(rate * time_s) @ turn) / time_s
    x, y, z = (float(one) for one in rate)
    same, stated = np.eye(3), ", ".join(f"{one:.4g}" for one in problem.body.spin_rad_s)
    found = f"expected about [{x:.4g}, {y:.4g}, {z:.4g}] by gyro and rims, found [{stated}]"
    yield ImuMistake(found, "spin_rad_s", same, same, Path(layout.DESCRIPTION), spin_rad_s=(x, y, z))


def _attitudes(problem: Problem) -> list[tuple[int, FloatArray]]:
    """Stamps of some frames spread over a descent, and their attitudes gRb by their rims alone."""
    enough = []
    for frame in problem.frames:
        rims = frame.rims.matched_once()
        if len(rims) >= _POSE_RIMS:
            enough.append(replace(frame, rims=rims))
    out = []
    for k in np.unique(np.linspace(0, len(enough) - 1, _POSES).astype(int)) if enough else ():
        matched = MatchedRims.of(enough[k].rims, problem.catalog)
        found = solve(ResectionProblem(matched, problem.camera.bTc, sun=enough[k].sun)).poses
        if found:
            out.append((enough[k].stamp_ns, found[0].gTb[:3, :3]))
    return out


def _about_optical_axis(bRc: FloatArray, turns: int) -> FloatArray:
    """Rotation (3, 3) in b by some quarter turns about the camera's optical axis."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(bRc @ np.linalg.matrix_power(quarter, turns) @ bRc.T)
