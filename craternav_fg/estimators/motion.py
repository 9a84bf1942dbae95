"""What connects two states where a motion model stands in for IMU preintegration."""

import math

import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.graph import FactorGraph, GraphOptions
from craternav_fg.linalg import whitening
from factors.arrays import FloatArray
from factors.kernels import strapdown
from factors.motion import motion_factor


def longest_interval_s(descent: Descent, options: GraphOptions) -> float:
    """Longest interval between two states of a graph: unbounded with a motion model, which is exact.

    Parameters
    ----------
    descent : Descent
    options : GraphOptions

    Returns
    -------
    float
    """
    return options.keyframe_s if descent.motion is None else math.inf


def transition(
    descent: Descent, state: tuple[FloatArray, FloatArray, FloatArray], begin_ns: int, end_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Transition of the error state over an interval, and the noise that is added.

    Parameters
    ----------
    descent : Descent
    state : (ndarray, ndarray, ndarray)
        At the beginning: gTb (4, 4), m; gV (3,) in g, m/s; bias (6,), gyro and accelerometer, in b.
    begin_ns, end_ns : int
        The interval.

    Returns
    -------
    F : ndarray, shape (15, 15)
        See `factors.kernels.strapdown.transition`, rad, m, s.
    Q : ndarray, shape (15, 15)
        Covariance of the noise, rad, m, s.

    Raises
    ------
    ValueError
        When the IMU log does not cover the interval.
    """
    dt_s, gyro, accelerometer = descent.imu.between(begin_ns, end_ns)
    if descent.motion is not None:
        return descent.motion.transition(descent.body, state, (dt_s, gyro), descent.imu_noise)[2:]
    spin = np.array(descent.body.spin_rad_s)
    return strapdown.transition(
        *state, dt_s, gyro, accelerometer, descent.body.mu_m3_s2, spin, descent.imu_noise.densities
    )


def add_motion(
    graph: FactorGraph,
    descent: Descent,
    index: int,
    begin_ns: int,
    end_ns: int,
    state: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Add the factor of the motion model from one state to the next.

    Parameters
    ----------
    graph : FactorGraph
    descent : Descent
        With a motion model.
    index : int
        Index of the state at the beginning.
    begin_ns, end_ns : int
        The interval.
    state : (ndarray, ndarray, ndarray)
        As in `transition`: where the noise's covariance is evaluated.
    """
    motion, body, noise = descent.motion, descent.body, descent.imu_noise
    assert motion is not None
    rows = descent.imu.between(begin_ns, end_ns)[:2]

    def propagate(
        gTb: FloatArray, gV: FloatArray, bias: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        return motion.transition(body, (gTb, gV, bias), rows, noise)[:3]

    i, j = index, index + 1
    W = whitening(motion.transition(body, state, rows, noise)[3])
    graph.push_back(motion_factor([X(i), V(i), B(i), X(j), V(j), B(j)], propagate, W))
