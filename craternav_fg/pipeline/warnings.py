"""Warnings: what a user must know before trusting a reconstruction, each one sentence.

They are computed from numbers that the reconstruction holds. The command line, the report and notebooks show
the same ones, see `Reconstruction.warnings`.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.evaluation.innovations import Innovations
from craternav_fg.evaluation.sensor_consistency import ResidualSummary, improbable
from craternav_fg.linalg import squared_distance
from factors.arrays import BoolArray, FloatArray

# Share of outliers among all rims above which an estimator's trajectory is not to be trusted.
MAX_OUTLIER_SHARE = 0.5
# Limits of the mean square per dimension (expected 1) of innovations and residuals. On sound data, a thousand
# and more give 0.97 to 1.05; the errors of rims in images are only approximately white, so their limit is
# wider.
MIN_SQUARE, MAX_SQUARE, MAX_SQUARE_IN_IMAGES = 0.6, 1.1, 1.5
# Mean of a residual's component, in sigmas and in its own standard deviations.
MAX_MEAN, MAX_MEAN_SIGMAS = 0.5, 6.0
# Stamps without a fault after which a fault is one that began: not of units or axes.
_SOUND_STAMPS = 5
# Distance of an outlier in sigmas, and the largest share of samples that is reported as outliers.
OUTLIER_SIGMAS, MAX_SENSOR_OUTLIER_SHARE = 7.0, 0.3
# Share of a sensor's samples that may say nothing of the predicted state.
MAX_SHARE_WITHOUT = 0.5
# Norm of the three errors of attitude, position, velocity or a bias, in sigmas of the prior: chance exceeds
# it once in 70,000.
MAX_PRIOR_SIGMAS = 5.0
# The same of the position: a catalogue in another frame shows nowhere else. Chance exceeds it once in 900.
MAX_POSITION_SIGMAS = 4.0
# That estimator's prior of the offset is 20 ms: an offset of half a second is not found.
_STAMPS = (
    "stamps (time offset between camera and IMU; -e self_calibrating_smoother estimates one of tens of ms)"
)
_PREDICTION_CHECKS = (
    "the body's spin and gravity, T_BS, pixel coordinates, intrinsics and lens of the camera, " + _STAMPS
)
# What to check in place of the IMU where a motion model predicts.
_MOTION_CHECKS = (
    f"[motion] in dataset.toml (its densities, rate_rad_s and rate_walk_rad_s2_sqrt_hz), {_PREDICTION_CHECKS}"
)
# What to check when the innovations of a sensor are too large.
_SENSOR_CHECKS = {
    "imu": f"its units and noise, {_PREDICTION_CHECKS}",
    "rims": (
        "the rims' covariances, shapes and angles, their heights, sizes, angles and slopes in the catalogue, "
        f"intrinsics, lens and T_BS of the camera, the body's spin, the matches, {_STAMPS}"
    ),
    "sun": "sun.csv (from the body to the sun, in g) and the tilts (rad)",
}
_OTHER_CHECKS = "its units, T_BS and noise in sensor.yaml"
# What to check when the first state leaves its prior.
_PRIOR_CHECKS = {
    "attitude": "the quaternion's order (w, x, y, z), T_BS",
    "position": (
        "longitudes and latitudes in the catalogue, intrinsics and lens of the camera, the initial position "
        "and its sigma"
    ),
    "velocity": (
        "its frame (it is relative to the rotating body) and its sigma, intrinsics and lens of the camera, "
        f"{_STAMPS}"
    ),
    "gyro bias": f"unit and scale of the gyro, the body's spin, T_BS and lens of the camera, {_STAMPS}",
    "accelerometer bias": (
        f"unit and scale of the accelerometer, gravity, T_BS, intrinsics and lens of the camera, {_STAMPS}"
    ),
}
# What to check when no rim is found in any image.
_NO_RIMS_CHECKS = "check catalogue, sun.csv, T_BS and the initial state"
# Share of the frames which should show catalogue craters that may show none: beyond, the few rims there are
# may be matched wrongly.
_MAX_MISSED_SHARE = 0.8
_IMU_ALONE = "there the trajectory rests on the IMU, and its covariance grows"
_OTHERS_ALONE = "there the trajectory rests on the IMU and {}"


def singular_covariances(pose_covariances: Mapping[str, FloatArray | None]) -> list[str]:
    """Warn of estimators with a singular covariance, whose consistency cannot be judged.

    Parameters
    ----------
    pose_covariances : mapping of str to ndarray, shape (k, 6, 6), or None
        By estimator, rad and m.

    Returns
    -------
    list of str
    """
    problems = []
    for name, covariances in pose_covariances.items():
        if covariances is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            regular = np.isfinite(squared_distance(np.ones(covariances.shape[:2]), covariances))
        if not regular.all():
            problems.append(
                f"{name}: the covariance of its pose is singular in {np.count_nonzero(~regular)} of "
                f"{len(regular)} frames, so it has no ANEES"
            )
    return problems


def failed_estimators(failures: Mapping[str, str]) -> list[str]:
    """Warn of estimators that produced no trajectory.

    Parameters
    ----------
    failures : mapping of str to str
        By the estimator's name, a message that begins with it.

    Returns
    -------
    list of str
    """
    return [f"no trajectory from {message}" for message in failures.values()]


def inconsistent_trajectories(
    outlier_shares: Mapping[str, float | None], mistake: Callable[[], str] = str
) -> list[str]:
    """Warn of trajectories at which most rims are outliers.

    Parameters
    ----------
    outlier_shares : mapping of str to float or None
        By estimator, see `evaluation.residuals.outlier_share`.
    mistake : callable, optional
        Asked for the likely mistake, if there are such trajectories; see `pipeline.rim_mistakes`.

    Returns
    -------
    list of str
    """
    astray = [
        f"{name} ({100.0 * share:.0f} %)"
        for name, share in outlier_shares.items()
        if share is not None and share > MAX_OUTLIER_SHARE and name != DeadReckoning.name
    ]
    if not astray:
        return []
    likely = mistake()
    cause = (
        f"the likely cause, as they agree once it is undone: {likely}"
        if likely
        else "check the units and axes of IMU and catalogue, T_BS, the matches"
    )
    return [
        f"most rims are outliers (beyond 7 sigma) at the poses of {', '.join(astray)}, which cannot be "
        f"trusted; {cause}"
    ]


def too_large(mean_square: float, dimension: int, *, images: bool) -> bool:
    """Whether innovations or residuals are larger than their noise and chance explain.

    Parameters
    ----------
    mean_square : float
        Mean square per dimension; 1 expected.
    dimension : int
        Number of squares.
    images : bool
        Whether rims and sun tilts were measured in images, see `inconsistent_sensors`.

    Returns
    -------
    bool
    """
    return mean_square > _limit(images=images) and improbable(mean_square, dimension)


def _limit(*, images: bool) -> float:
    return MAX_SQUARE_IN_IMAGES if images else MAX_SQUARE


def contradicted_without_rims(name: str, innovations: Innovations | None) -> list[str]:
    """Warn of trajectories that rest on sensors which contradict each other, without any rim to decide.

    A few ranges from poor initial states, for example, fit several trajectories: an estimator takes one of
    them, and its covariance does not know of the others.

    Parameters
    ----------
    name : str
        Name of the filter.
    innovations : Innovations or None
        Its innovations; None where rims were measured.

    Returns
    -------
    list of str
        One sentence for all sensors.
    """
    contradicted = []
    for sensor in sorted(set(innovations.sensor)) if innovations is not None else []:
        assert innovations is not None
        part = innovations.of(sensor)
        if too_large(part.mean, int(part.dimension.sum()), images=False):
            contradicted.append(f"{sensor} (NIS per dimension {part.mean:.3g}, expected 1)")
    if not contradicted:
        return []
    return [
        f"no trajectory can be trusted, whatever its covariance: no rim was measured, and {name} does not "
        f"predict {', '.join(contradicted)}; give smaller initial sigmas, rims, or a star tracker"
    ]


def inconsistent_sensors(
    name: str,
    innovations: Innovations | None,
    residuals: Mapping[str, ResidualSummary],
    *,
    images: bool,
    motion: bool = False,
) -> list[str]:
    """Warn of sensors whose innovations or residuals are not what their noise says.

    Parameters
    ----------
    name : str
        Name of the filter.
    innovations : Innovations or None
        Its innovations, if it ran.
    residuals : mapping of str to ResidualSummary
        Residuals of a smoother, by sensor; empty without one.
    images : bool
        Whether rims and sun tilts were measured in images. Most of their errors are common to all frames;
        so their innovations are smaller than their noise, and their residuals have a mean.
    motion : bool
        Whether a motion model predicts, which may be what is wrong, in place of an IMU.

    Returns
    -------
    list of str
        One sentence for each sensor.
    """
    found: dict[str, str] = {}
    seen = sorted(set(innovations.sensor)) if innovations is not None else []
    for sensor in seen:
        assert innovations is not None
        problem = _of_innovations(innovations.of(sensor), name, images=images, motion=motion)
        if problem:
            found[sensor] = problem
    for sensor, summary in residuals.items():
        problem = _of_residuals(summary, images=images and sensor in ("rims", "sun"))
        if problem and sensor not in found:
            found[sensor] = problem
    checks = {**_SENSOR_CHECKS, "imu": _MOTION_CHECKS} if motion else _SENSOR_CHECKS
    return [
        f"{sensor}: {problem}; check {checks.get(sensor, _OTHER_CHECKS)}" for sensor, problem in found.items()
    ]


def contradicted_intrinsics(contradicted: bool) -> list[str]:
    """Warn of intrinsics that the rims contradict.

    Parameters
    ----------
    contradicted : bool
        See `intrinsics_check.contradicted_intrinsics`.

    Returns
    -------
    list of str
    """
    if not contradicted:
        return []
    return [
        "the rims by themselves, frame by frame, contradict the camera's intrinsics: check focal lengths, "
        "principal point, lens and resolution in its sensor.yaml"
    ]


def contradicted_lens(contradicted: bool) -> list[str]:
    """Warn of a distortion that the rims contradict.

    Parameters
    ----------
    contradicted : bool
        See `intrinsics_check.contradicted_lens`.

    Returns
    -------
    list of str
    """
    if not contradicted:
        return []
    return [
        "the rims by themselves, frame by frame, contradict the camera's lens, and positions may be wrong by "
        "more than is stated: check its distortion, whether images are rectified, and errors of the map that "
        "the catalogue does not state"
    ]


def _of_innovations(part: Innovations, name: str, *, images: bool, motion: bool) -> str:
    without = float(np.mean(part.dimension == 0))
    if without > MAX_SHARE_WITHOUT:
        return f"{100.0 * without:.3g} % of its samples cannot be from where {name} predicts the lander"
    size = int(part.dimension.sum())
    sigmas = np.sqrt(part.nis / np.maximum(part.dimension, 1))
    share = float(np.mean(sigmas > OUTLIER_SIGMAS))
    inside = part.nis[sigmas <= OUTLIER_SIGMAS].sum()
    rest = float(inside / max(part.dimension[sigmas <= OUTLIER_SIGMAS].sum(), 1))
    if 0.0 < share < MAX_SENSOR_OUTLIER_SHARE and rest < _limit(images=images) < part.mean:
        return f"{100.0 * share:.2g} % of its samples are outliers (beyond {OUTLIER_SIGMAS:g} sigma)"
    if too_large(part.mean, size, images=images):
        return (
            f"contradicts what {name} predicts from the other sensors (NIS per dimension {part.mean:.3g}, "
            f"expected 1{_onset(part)})"
        )
    if part.mean < MIN_SQUARE and not images and improbable(part.mean, size):
        too_wide = (
            "the stated noise, or a density of [motion] in dataset.toml," if motion else "the stated noise"
        )
        return (
            f"agrees with what {name} predicts better than the stated noise allows (NIS per dimension "
            f"{part.mean:.3g}, expected 1): {too_wide} is too large or in another unit"
        )
    return ""


def _onset(part: Innovations) -> str:
    """Name the stamp from which innovations are too large, if those before are not."""
    stamps_ns, rows = np.unique(part.stamps_ns, return_inverse=True)
    nis, dimension = np.bincount(rows, part.nis), np.bincount(rows, part.dimension)
    wrong = [n > d > 0 and improbable(n / d, int(d)) for n, d in zip(nis, dimension, strict=True)]
    first = wrong.index(True) if any(wrong) else 0
    before = int(dimension[:first].sum())
    if first < _SOUND_STAMPS or too_large(nis[:first].sum() / max(before, 1), before, images=False):
        return ""
    return f", but only from {stamps_ns[first]} ns on"


def _of_residuals(summary: ResidualSummary, *, images: bool) -> str:
    size = summary.count * len(summary.mean)
    worst = float(np.max(np.abs(summary.mean)))
    if worst > MAX_MEAN and worst * np.sqrt(summary.count) > MAX_MEAN_SIGMAS and not images:
        return f"its residuals at the smoothed trajectory have a mean of {worst:.2g} sigma"
    if too_large(summary.square, size, images=images):
        return f"its residuals at the smoothed trajectory are {np.sqrt(summary.square):.2g} times their noise"
    return ""


def contradicted_prior(sigmas: Mapping[str, float], as_xyzw: float, displaced: str = "") -> list[str]:
    """Warn of an initial state, and of biases, that the data contradict.

    Parameters
    ----------
    sigmas : mapping of str to float
        See `evaluation.sensor_consistency.prior_sigmas`; empty without a smoother.
    as_xyzw : float
        The attitude's, had its quaternion been written with the scalar last.
    displaced : str
        Where the smoothed position is from the initial one.

    Returns
    -------
    list of str
    """
    out = []
    for what, away in sigmas.items():
        if away <= (MAX_POSITION_SIGMAS if what == "position" else MAX_PRIOR_SIGMAS):
            continue
        check = _PRIOR_CHECKS[what]
        if what == "attitude" and as_xyzw < min(0.6 * away, MAX_PRIOR_SIGMAS):
            check = "the quaternion's order: read as x, y, z, w it agrees, and w, x, y, z is expected"
        where = f": {displaced}" if displaced and what == "position" else ""
        out.append(
            f"the smoothed trajectory is {away:.2g} sigma from the "
            f"{'initial ' if 'bias' not in what else 'prior of the '}{what}{where}; check {check}"
        )
    return out


def lowered_rims(lowered: bool) -> list[str]:
    """Tell that heights in the catalogue were taken for those of the rims' points.

    Parameters
    ----------
    lowered : bool

    Returns
    -------
    list of str
    """
    if not lowered:
        return []
    return [
        "RIM_HEIGHT_M was taken for the mean height along the rims, as the rims contradict planes of that "
        "height: their planes were lowered by a^2 / 2R"
    ]


def replaced_states(
    origin: str, reinitialised_at: Sequence[int], mistake: str = "", displaced: str = ""
) -> list[str]:
    """Warn of an initial state that was replaced, and of frames at which the track was re-initialised.

    Parameters
    ----------
    origin : str
        See `Reconstruction.origin`.
    reinitialised_at : sequence of int
        Indices of frames.
    mistake : str
        What would explain that the images contradict the initial state; empty when nothing is known.
    displaced : str
        Where the position is from the initial one, if that contradicts it.

    Returns
    -------
    list of str
    """
    out = []
    if origin == "replaced":
        text = "the images contradict the initial state: it was replaced by one from identified craters"
        if displaced:
            text += f", {displaced}; check {_PRIOR_CHECKS['position']}"
        out.append(f"{text}; {mistake}" if mistake else text)
    if reinitialised_at:
        out.append(
            "track was lost, and craters identified later contradict the IMU: re-initialised at frame "
            + ", ".join(map(str, reinitialised_at))
        )
    return out


def frames_without_rims(
    rims: Sequence[int], expected: Sequence[int] | None, mistake: str = "", sensors: Sequence[str] = ()
) -> list[str]:
    """Warn of frames in which no rim was measured.

    Parameters
    ----------
    rims : sequence of int
        Measured rims of each frame.
    expected : sequence of int or None
        Catalogue craters that each frame should show; None when none were searched in images.
    mistake : str
        What would explain that there is no rim in any frame; empty when nothing is known.
    sensors : sequence of str
        Names of the sensors beside camera and IMU.

    Returns
    -------
    list of str
    """
    alone = _OTHERS_ALONE.format(", ".join(sensors)) if sensors else _IMU_ALONE
    empty: BoolArray = np.array(rims) == 0
    missed: BoolArray = empty & (np.array(expected) > 0) if expected is not None else np.zeros_like(empty)
    if expected is not None and empty.all():
        if not missed.any():
            return [
                "no rim was found in any frame: where the initial state and the IMU put the lander, no "
                "crater of the catalogue is in view, or the sun is below the horizon; "
                f"{mistake or _NO_RIMS_CHECKS}"
            ]
        return [
            f"no rim was found in any frame, although {int(missed.sum())} should show some: no pose within "
            f"the prior explains the images; {mistake or _NO_RIMS_CHECKS}"
        ]
    out = []
    if expected is not None and missed.sum() > _MAX_MISSED_SHARE * np.count_nonzero(expected):
        out.append(
            f"no trajectory can be trusted, whatever its covariance: {int(np.count_nonzero(~empty))} of "
            f"{int(np.count_nonzero(expected))} frames confirm it, the others should show catalogue craters "
            f"and do not; {mistake or _NO_RIMS_CHECKS}"
        )
    elif missed.any():
        out.append(
            f"no rim was found in {_count(missed)} that should show catalogue craters; {alone}; if this "
            "happens often, check the catalogue, the camera's intrinsics, the body and the IMU's units "
            "and axes"
        )
    others = empty & ~missed
    if others.any():
        what = "no rim was measured in" if expected is None else "no catalogue crater is in view in"
        out.append(f"{what} {_count(others)}; {alone}")
    return out


def _count(frames: BoolArray) -> str:
    """Write how many frames a mask (k,) selects, and the first of them."""
    return f"{int(frames.sum())} of {len(frames)} frames (the first: {int(np.argmax(frames))})"
