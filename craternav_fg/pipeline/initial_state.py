"""An initial state from images: two pose fixes and the motion between them.

The two poses and the IMU, or the motion model, give the velocity, and so an initial state for a data set
that has none. The estimators measure the same images themselves, so the state must not count as another
measurement of them: its standard deviations are much larger than those of the poses.
"""

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.pipeline.relocalisation import PoseFix, Relocaliser
from craternav_fg.trajectory import InitialState
from factors.arrays import FloatArray

# Standard deviations of the initial state over those of the pose it is made of: its information is then 1 %
# of what the estimators take from the same image.
_SIGMA_FACTOR = 10.0
# Standard deviations of what the poses do not determine: biases of a tactical-grade IMU (10 deg/h, 1 mg). The
# angular velocity is measured by the gyro; without one the poses give its mean.
_GYRO_BIAS_SIGMA_RAD_S = 4.8e-5
_ACCELEROMETER_BIAS_SIGMA_M_S2 = 1e-2
_ANGULAR_VELOCITY_SIGMA_RAD_S = 0.01
# Images, evenly spaced, that are asked whether they are mirrored.
_ASKED = 5
# Of fixed-point iterations: each shrinks the error by gravity's gradient times the interval squared, 1e-2 for
# 100 s on the Moon.
_ITERATIONS = 8


def find_initial(
    dataset: Dataset,
    relocaliser: Relocaliser,
    report: Callable[[int], None],
    repeated: Collection[int] = (),
) -> InitialState:
    """Find an initial state of a data set that has none.

    Parameters
    ----------
    dataset : Dataset
    relocaliser : Relocaliser
    report : callable
        Called with the number of frames that were processed.
    repeated : collection of int
        Frames whose images are copies of earlier ones, and were not taken at their stamps.

    Returns
    -------
    InitialState
        At the first frame's stamp, from the first two frames with a pose fix.

    Raises
    ------
    EstimationError
        When there are no two such frames.
    """
    stamps = [int(stamp) for stamp in dataset.stamps_ns]
    seen: list[tuple[int, PoseFix]] = []
    for index, stamp in enumerate(stamps):
        fix = None if index in repeated else relocaliser.locate(index)
        report(index + 1)
        if fix is not None:
            seen.append((stamp, fix))
        if len(seen) == 2:
            break
    if len(seen) < 2:
        raise EstimationError(
            f"dataset.toml has no initial state, and of {len(stamps)} frames the craters of {len(seen)} were "
            f"identified, expected two{'' if seen else _mirrored(dataset, relocaliser)}"
        )
    (first_ns, first), (second_ns, second) = seen
    interval_s = 1e-9 * (second_ns - first_ns)
    spread_m2 = first.pose_covariance[3:, 3:] + second.pose_covariance[3:, 3:]
    velocity_m_s = float(np.sqrt(np.trace(spread_m2) / 3.0)) / interval_s
    state = initial_from_fix(first_ns, first, np.zeros(3), velocity_m_s)
    if dataset.motion is not None:
        state = _with_motion(state, dataset, first, second, interval_s)
    descent = Descent.of(dataset, state)
    gV = np.zeros(3)
    for _ in range(_ITERATIONS):
        ahead = filter_state.propagate(_with_mean(descent, first.gTb, gV), descent, first_ns, second_ns)
        gV = gV + (second.gTb[:3, 3] - ahead.gTb[:3, 3]) / interval_s
    return propagated_back(descent, replace(state, gV=gV), stamps[0])


def _mirrored(dataset: Dataset, relocaliser: Relocaliser) -> str:
    """Say that craters are identified once an image is mirrored; empty if they are not."""
    if dataset.measurements is not None:
        return ""
    for index in range(0, len(dataset), max(len(dataset) // _ASKED, 1)):
        rims = relocaliser.rims_if_mirrored(index)
        if rims:
            return (
                f"; {rims} are identified in {dataset.image_paths[index].name} if it is mirrored left to "
                "right, or the longitudes in the catalogue are positive west, or its latitudes positive south"
            )
    return ""


def _with_motion(
    state: InitialState, dataset: Dataset, first: PoseFix, second: PoseFix, interval_s: float
) -> InitialState:
    """Add the states that a motion model has instead of IMU biases to an initial state.

    Without a gyro the mean angular velocity is that between the two poses.
    """
    motion = dataset.motion
    assert motion is not None
    state = replace(state, accelerometer_bias_sigma_m_s2=motion.acceleration_sigma_m_s2)
    if dataset.imu is not None:
        return state
    spin = frames.rotation_exp(interval_s * np.array(dataset.body.spin_rad_s))
    rate = frames.rotation_log(first.gTb[:3, :3].T @ spin @ second.gTb[:3, :3]) / interval_s
    return replace(
        state,
        angular_velocity_rad_s=(float(rate[0]), float(rate[1]), float(rate[2])),
        angular_velocity_sigma_rad_s=motion.rate_sigma_rad_s,
        gyro_bias_sigma_rad_s=motion.rate_sigma_rad_s,
    )


def initial_from_fix(stamp_ns: int, fix: PoseFix, gV: FloatArray, velocity_sigma_m_s: float) -> InitialState:
    """Make an initial state of a pose and a velocity, wide enough to carry hardly any information.

    Parameters
    ----------
    stamp_ns : int
        Stamp of the pose's frame.
    fix : PoseFix
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    velocity_sigma_m_s : float
        Its standard deviation per axis.

    Returns
    -------
    InitialState
    """
    attitude_rad2, position_m2 = np.split(np.diag(fix.pose_covariance), 2)
    return InitialState(
        stamp_ns=stamp_ns,
        gTb=fix.gTb,
        gV=gV,
        attitude_sigma_rad=_SIGMA_FACTOR * float(np.sqrt(attitude_rad2.max())),
        position_sigma_m=_SIGMA_FACTOR * float(np.sqrt(position_m2.max())),
        velocity_sigma_m_s=_SIGMA_FACTOR * velocity_sigma_m_s,
        angular_velocity_sigma_rad_s=_ANGULAR_VELOCITY_SIGMA_RAD_S,
        gyro_bias_sigma_rad_s=_GYRO_BIAS_SIGMA_RAD_S,
        accelerometer_bias_sigma_m_s2=_ACCELEROMETER_BIAS_SIGMA_M_S2,
    )


def _with_mean(descent: Descent, gTb: FloatArray, gV: FloatArray) -> FilterState:
    """Prior of a descent with another pose and velocity."""
    return replace(filter_state.prior(descent), gTb=gTb, gV=gV)


def propagated_back(descent: Descent, state: InitialState, stamp_ns: int) -> InitialState:
    """Find the state at an earlier stamp from which the IMU leads to a given one.

    Parameters
    ----------
    descent : Descent
        Its IMU log and body.
    state : InitialState
    stamp_ns : int
        At or before the state's.

    Returns
    -------
    InitialState
        At that stamp; the position's standard deviation grows by what the velocity leaves open.
    """
    if stamp_ns == state.stamp_ns:
        return state
    interval_s = 1e-9 * (state.stamp_ns - stamp_ns)
    gTb, gV = state.gTb.copy(), state.gV
    gTb[:3, 3] -= interval_s * gV
    for _ in range(_ITERATIONS):
        ahead = filter_state.propagate(_with_mean(descent, gTb, gV), descent, stamp_ns, state.stamp_ns)
        step_m_s = state.gV - ahead.gV
        gTb = gTb.copy()
        gTb[:3, :3] = state.gTb[:3, :3] @ ahead.gTb[:3, :3].T @ gTb[:3, :3]
        gTb[:3, 3] += state.gTb[:3, 3] - ahead.gTb[:3, 3] - interval_s * step_m_s
        gV = gV + step_m_s
    return replace(
        state,
        stamp_ns=stamp_ns,
        gTb=gTb,
        gV=gV,
        position_sigma_m=float(np.hypot(state.position_sigma_m, interval_s * state.velocity_sigma_m_s)),
    )
