"""Warnings: what a user must know before trusting a reconstruction, each one sentence.

They are computed from numbers that the reconstruction holds. The command line, the report and notebooks show
the same ones, see `Reconstruction.warnings`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from craternav_fg.evaluation.innovations import Innovations

BoolArray = npt.NDArray[np.bool_]

# Share of outliers among all rims above which an estimator's trajectory is not to be trusted.
MAX_OUTLIER_SHARE = 0.5
# Uses no rims, so that they need not agree with it.
_UNAIDED = "dead_reckoning"
# NIS per dimension above which a sensor contradicts the prediction: an underestimated noise gives less.
MAX_NIS = 3.0
# What to check when the innovations of a sensor are too large.
_SENSOR_CHECKS = {
    "imu": "its units and noise, the body's spin and gravity",
    "rims": "heights and sizes in the catalogue, T_BS, the body's spin, the matches",
    "sun": "sun.csv (from the body to the sun, in g) and the tilts (rad)",
}
_OTHER_CHECKS = "its units, T_BS and noise in sensor.yaml"
_IMU_ALONE = "there the trajectory rests on the IMU, and its covariance grows"


def failed_estimators(failures: Mapping[str, str]) -> list[str]:
    """Warn of estimators that gave no trajectory.

    Parameters
    ----------
    failures : mapping of str to str
        By the estimator's name, a message that begins with it.

    Returns
    -------
    list of str
    """
    return [f"no trajectory of {message}" for message in failures.values()]


def inconsistent_trajectories(outlier_shares: Mapping[str, float | None]) -> list[str]:
    """Warn of trajectories at which most rims are outliers.

    Parameters
    ----------
    outlier_shares : mapping of str to float or None
        By estimator, see `evaluation.residuals.outlier_share`.

    Returns
    -------
    list of str
    """
    astray = [
        f"{name} ({100.0 * share:.0f} %)"
        for name, share in outlier_shares.items()
        if share is not None and share > MAX_OUTLIER_SHARE and name != _UNAIDED
    ]
    if not astray:
        return []
    return [
        f"most rims are outliers (beyond 7 sigma) at the poses of {', '.join(astray)}, which cannot be "
        "trusted; check the units and axes of IMU and catalogue, T_BS, the matches"
    ]


def inconsistent_sensors(name: str, innovations: Innovations | None) -> list[str]:
    """Warn of sensors whose innovations are far larger than predicted.

    Parameters
    ----------
    name : str
        Of the filter.
    innovations : Innovations or None
        Its innovations, if it ran.

    Returns
    -------
    list of str
    """
    if innovations is None:
        return []
    return [
        f"{sensor}: contradicts what {name} predicts from the other sensors (NIS per dimension "
        f"{found['mean']:.3g}, expected 1); check {_SENSOR_CHECKS.get(sensor, _OTHER_CHECKS)}"
        for sensor, found in innovations.as_dict().items()
        if found["mean"] > MAX_NIS
    ]


def unknown_sensors(ignored: Sequence[str]) -> list[str]:
    """Warn of sensors' folders that were not read.

    Parameters
    ----------
    ignored : sequence of str
        Names of folders below `mav0`.

    Returns
    -------
    list of str
    """
    if not ignored:
        return []
    return [f"not used: mav0/{', mav0/'.join(ignored)}: no sensor of this name is known (craternav sensors)"]


def replaced_states(origin: str, reinitialised_at: Sequence[int]) -> list[str]:
    """Warn of an initial state that was replaced, and of frames at which the track was re-initialised.

    Parameters
    ----------
    origin : str
        See `Reconstruction.origin`.
    reinitialised_at : sequence of int
        Indices of frames.

    Returns
    -------
    list of str
    """
    out = []
    if origin == "replaced":
        out.append("the images contradict the initial state: replaced by one from identified craters")
    if reinitialised_at:
        out.append(
            "track was lost, and craters identified later contradict the IMU: re-initialised at frame "
            + ", ".join(map(str, reinitialised_at))
        )
    return out


def frames_without_rims(rims: Sequence[int], expected: Sequence[int] | None) -> list[str]:
    """Warn of frames in which no rim was measured.

    Parameters
    ----------
    rims : sequence of int
        Measured rims of each frame.
    expected : sequence of int or None
        Catalogue craters that each frame should show; None when no images were processed.

    Returns
    -------
    list of str
    """
    empty: BoolArray = np.array(rims) == 0
    missed: BoolArray = empty & (np.array(expected) > 0) if expected is not None else np.zeros_like(empty)
    if expected is not None and empty.all():
        return [
            f"no rim was found in any frame, although {int(missed.sum())} should show some: no pose within "
            "the prior explains the images; check catalogue, sun.csv, T_BS and the initial state"
        ]
    out = []
    if missed.any():
        out.append(
            f"no rim was found in {_count(missed)} that should show catalogue craters; {_IMU_ALONE}; if this "
            "happens often, check the IMU's units and axes, the body"
        )
    others = empty & ~missed
    if others.any():
        what = "no rim was measured in" if expected is None else "no catalogue crater is in view in"
        out.append(f"{what} {_count(others)}; {_IMU_ALONE}")
    return out


def _count(frames: BoolArray) -> str:
    """Write how many frames a mask (k,) selects, and the first of them."""
    return f"{int(frames.sum())} of {len(frames)} frames (the first: {int(np.argmax(frames))})"
