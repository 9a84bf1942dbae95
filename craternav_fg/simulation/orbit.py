"""A lander that moves as a motion model says, such as in free fall, with a draw of the process noise."""

import math

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.motion.model import Motion as MotionModel
from craternav_fg.simulation.scenario_tables import TrajectorySection
from craternav_fg.simulation.trajectory import Motion, Track
from factors.arrays import FloatArray, IntArray


class Orbit(Track):
    """A motion from the trajectory's start, with the noise of a motion model added at each frame.

    Between frames it is free of noise. The camera points as the trajectory's attitude says at the start, and
    turns on with the angular velocity that keeps it so.

    Parameters
    ----------
    body : Body
    options : TrajectorySection
        Its start and attitude.
    model : MotionModel
        Without a gyro.
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, from 0.
    rng : numpy.random.Generator
    """

    def __init__(
        self,
        body: Body,
        options: TrajectorySection,
        model: MotionModel,
        stamps_ns: IntArray,
        rng: np.random.Generator,
    ) -> None:
        self.body = body
        self.model = model
        self.stamps_ns = stamps_ns
        self._states = [_start(body, options, model)]
        for seconds in np.diff(stamps_ns) * 1e-9:
            state = self._states[-1]
            gTb, gV, _, Q = model.free(body, state, float(seconds))
            scale = np.sqrt(np.diag(Q))
            step = scale * (np.linalg.cholesky(Q / np.outer(scale, scale)) @ rng.standard_normal(len(Q)))
            gTb[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(step[:3])
            gTb[:3, 3] += step[3:6]
            self._states.append((gTb, gV + step[6:9], state[2] + step[9:]))

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
        poses, velocities, rates = [], [], []
        for t in np.asarray(t_s, dtype=np.float64).tolist():
            k = max(int(np.searchsorted(self.stamps_ns, round(t * 1e9), side="right")) - 1, 0)
            gTb, gV, bias = self._states[k]
            since = t - 1e-9 * float(self.stamps_ns[k])
            if since != 0.0:
                gTb, gV, _, _ = self.model.free(self.body, (gTb, gV, bias), since)
            poses.append(gTb)
            velocities.append(gV)
            rates.append(np.array(self.model.rate_rad_s) - bias[:3])
        gTb, rate = np.array(poses), np.array(rates)
        return Motion(gTb[:, :3, 3], np.array(velocities), gTb[:, :3, :3], np.zeros_like(rate), rate)


def _start(
    body: Body, options: TrajectorySection, model: MotionModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State at the start: level flight along the heading, the camera's pitch kept by the angular velocity."""
    enu = frames.east_north_up(np.radians(options.site_latitude_deg), np.radians(options.site_longitude_deg))
    heading = math.radians(options.heading_deg)
    up, ahead = enu[:, 2], math.sin(heading) * enu[:, 0] + math.cos(heading) * enu[:, 1]
    start, R = options.start, body.radius_m
    angle, radius = start.downrange_m / R, R + start.altitude_m
    up, ahead = (
        math.cos(angle) * up + math.sin(angle) * ahead,
        math.cos(angle) * ahead - math.sin(angle) * up,
    )
    gRn = np.stack([ahead, np.cross(-up, ahead), -up], axis=-1)
    pitch = math.radians(options.attitude.start_pitch_deg)
    gRb = gRn @ frames.rotation_exp(np.array([0.0, pitch, 0.0]))
    turn = start.ground_speed_m_s / R
    rate = gRb.T @ (-turn * gRn[:, 1] + np.array(body.spin_rad_s))
    gV = start.vertical_speed_m_s * up + turn * radius * ahead
    bias = np.concatenate([np.array(model.rate_rad_s) - rate, np.zeros(3)])
    return frames.pose(gRb, radius * up), gV, bias
