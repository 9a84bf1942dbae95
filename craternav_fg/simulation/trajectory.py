"""Analytic powered descents that obey the motion equations (26)-(27) exactly."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.simulation.scenario_tables import TrajectorySection
from factors.arrays import FloatArray


@dataclass(frozen=True)
class Motion:
    """Motion of the lander at n times.

    Attributes
    ----------
    gP : ndarray, shape (n, 3)
        Position in g, m.
    gV : ndarray, shape (n, 3)
        Velocity relative to g, in g, m/s.
    gRb : ndarray, shape (n, 3, 3)
        Rotations from b to g.
    specific_force_m_s2 : ndarray, shape (n, 3)
        In b, m/s^2.
    angular_velocity_rad_s : ndarray, shape (n, 3)
        Inertial, in b, rad/s.
    """

    gP: FloatArray
    gV: FloatArray
    gRb: FloatArray
    specific_force_m_s2: FloatArray
    angular_velocity_rad_s: FloatArray

    @property
    def gTb(self) -> FloatArray:
        """Poses of the body in g, shape (n, 4, 4)."""
        T = np.zeros((len(self.gP), 4, 4))
        T[:, :3, :3] = self.gRb
        T[:, :3, 3] = self.gP
        T[:, 3, 3] = 1.0
        return T


class Track(Protocol):
    """A true motion above a body."""

    body: Body

    def evaluate(self, t_s: FloatArray) -> Motion:
        """Return the motion at some times.

        Parameters
        ----------
        t_s : ndarray, shape (n,)
            From the start.

        Returns
        -------
        Motion
        """
        ...


class Descent(Track):
    """A descent above a great circle: quintic polynomials in altitude and downrange.

    Each has given position, velocity and acceleration at both ends, as in the guidance of powered descents.
    Specific force and angular velocity follow from eqs. (26) and (27) by inverse dynamics.

    Parameters
    ----------
    body : Body
    options : TrajectorySection
        Boundary states, attitude, times.

    Raises
    ------
    ValueError
        When the polynomial leads below the reference sphere, or the end is not given.

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eqs. (26) and (27).
    """

    def __init__(self, body: Body, options: TrajectorySection) -> None:
        self.body = body
        self.options = options
        self.duration_s = options.duration_s
        if options.end is None:
            raise ValueError("expected a table [trajectory.end]")
        start, end, T = options.start, options.end, options.duration_s
        self._altitude = _quintic(
            (start.altitude_m, start.vertical_speed_m_s, start.vertical_acceleration_m_s2),
            (end.altitude_m, end.vertical_speed_m_s, end.vertical_acceleration_m_s2),
            T,
        )
        self._downrange = _quintic(
            (start.downrange_m, start.ground_speed_m_s, start.ground_acceleration_m_s2),
            (end.downrange_m, end.ground_speed_m_s, end.ground_acceleration_m_s2),
            T,
        )
        enu = frames.east_north_up(
            np.radians(options.site_latitude_deg), np.radians(options.site_longitude_deg)
        )
        heading = math.radians(options.heading_deg)
        self._site = enu[:, 2]
        self._ahead = math.sin(heading) * enu[:, 0] + math.cos(heading) * enu[:, 1]
        lowest_m = float(self._altitude(np.linspace(0.0, T, 1001)).min())
        if lowest_m <= 0.0:
            raise ValueError(f"the descent leads to an altitude of {lowest_m:.0f} m")

    def evaluate(self, t_s: FloatArray) -> Motion:
        """Return the motion at some times.

        Parameters
        ----------
        t_s : ndarray, shape (n,)
            From the start.

        Returns
        -------
        Motion
        """
        t = np.asarray(t_s, dtype=np.float64)
        R = self.body.radius_m
        r, dr, ddr = R + self._altitude(t), self._altitude.deriv(1)(t), self._altitude.deriv(2)(t)
        angle, rate, acceleration = (
            self._downrange(t) / R,
            self._downrange.deriv(1)(t) / R,
            self._downrange.deriv(2)(t) / R,
        )
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        up = cos * self._site + sin * self._ahead
        ahead = cos * self._ahead - sin * self._site
        P = r[:, None] * up
        V = dr[:, None] * up + (r * rate)[:, None] * ahead
        A = (ddr - r * rate**2)[:, None] * up + (2.0 * dr * rate + r * acceleration)[:, None] * ahead

        gRn = np.stack([ahead, np.cross(-up, ahead), -up], axis=-1)
        nRb, level_rate = self._level_attitude(t)
        gRb = gRn @ nRb
        # The level frame rotates about its -y axis as the lander moves around the body.
        level_rate -= rate[:, None] * nRb[:, 1, :]
        spin = np.array(self.body.spin_rad_s)
        bRg = np.swapaxes(gRb, 1, 2)
        # eq. (27): d gRb/dt = gRb [w_b - gRb' w_spin]x
        angular_velocity = level_rate + bRg @ spin
        # eq. (26), solved for the specific force
        inertial = A + 2.0 * np.cross(spin, V) + np.cross(spin, np.cross(spin, P))
        force = np.einsum("nij,nj->ni", bRg, inertial - self.body.gravity(P))
        return Motion(P, V, gRb, force, angular_velocity)

    def _level_attitude(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Attitude (n, 3, 3) relative to the local level frame, and its rate (n, 3) in b, rad/s."""
        options = self.options.attitude
        x = t / self.duration_s
        swing = math.radians(options.end_pitch_deg - options.start_pitch_deg)
        amplitudes = np.radians(options.oscillation_deg)
        frequencies = 2.0 * np.pi / np.array(options.oscillation_period_s)
        # With equal phases the oscillation would be about one fixed axis.
        phases = frequencies * t[:, None] + np.array([0.0, 1.0, 2.0])
        angles = amplitudes * np.sin(phases)
        rates = amplitudes * frequencies * np.cos(phases)
        angles[:, 1] += math.radians(options.start_pitch_deg) + swing * x**3 * (10.0 + x * (6.0 * x - 15.0))
        rates[:, 1] += swing * 30.0 * (x * (1.0 - x)) ** 2 / self.duration_s

        pitch, roll, yaw = (_turns(axis, angles[:, axis]) for axis in (1, 0, 2))
        w = np.zeros((len(t), 3))
        for turn, axis in ((pitch, 1), (roll, 0), (yaw, 2)):
            w = np.einsum("nji,nj->ni", turn, w)
            w[:, axis] += rates[:, axis]
        return pitch @ roll @ yaw, w


def _turns(axis: int, angles: FloatArray) -> FloatArray:
    vectors = np.zeros((len(angles), 3))
    vectors[:, axis] = angles
    return frames.rotation_exp(vectors)


def _quintic(
    start: tuple[float, float, float], end: tuple[float, float, float], duration_s: float
) -> np.polynomial.Polynomial:
    """Polynomial of degree 5 with given value, first and second derivative at 0 and at the duration."""
    T = duration_s
    low = np.array([start[0], start[1], 0.5 * start[2]])
    powers = np.array([3, 4, 5])
    rows = np.stack([T**powers, powers * T ** (powers - 1), powers * (powers - 1) * T ** (powers - 2)])
    there = np.array(
        [low[0] + low[1] * T + low[2] * T**2, low[1] + 2.0 * low[2] * T, 2.0 * low[2]], dtype=np.float64
    )
    high = np.linalg.solve(rows, np.array(end) - there)
    return np.polynomial.Polynomial(np.concatenate([low, high]))
